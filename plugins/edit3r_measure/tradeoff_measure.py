"""Measure every point of a tradeoff on every scene, each pair in a process of its own; a sweep can
be killed.

What is timed is `edit3r run` itself, from the photos on disk to the last file written, as its
`run.json` tells it. The first runs warm the process up (compiled kernels, weights in the disk
cache) and are recorded but not counted.
"""

import contextlib
import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from jaxtyping import Float

from edit3r.cli.main import main as edit3r_command
from edit3r.config import merge
from edit3r.contract.interfaces import LossInputs, Rasterizer
from edit3r.contract.types import Reconstruction
from edit3r.errors import MissingDependencyError, RunError
from edit3r.io.cameras import read_scene_cameras
from edit3r.io.children import PYTHON
from edit3r.io.images import evenly, save_image
from edit3r.io.ply import load_ply
from edit3r.io.run_folder import RunFolder, installed_versions
from edit3r.pipeline.config import make_run_config
from edit3r.plugins.registry import Registry, default_registry
from edit3r.reporting import progress
from edit3r.workers import run_resumable
from edit3r_measure.metrics import psnr, ssim
from edit3r_measure.novel_view import RenderedView, predict, score_edit
from edit3r_measure.scene_sources import SceneFolder

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
LAST_WORDS = 300  # characters of a dead process's last words that are kept


@dataclass(frozen=True)
class Job:
    """What the process of one measurement is told; JSON data."""

    unedited: Mapping[
        str, Any
    ]  # laid over the settings for the run compared with novel views
    edited: Mapping[
        str, Any
    ]  # laid over the settings to edit with true edits, {folder} is where they are
    scene: str = ""  # scene folder
    settings: Mapping[str, Any] = field(
        default_factory=dict
    )  # run settings of the point
    image: str = ""  # where to leave the novel view as PNG
    perceptual: Sequence[str] = ()  # losses to try, in order
    warm_up: int = 1  # runs before those that count
    repeats: int = 3  # runs that count
    plugins: Sequence[str] = ()  # local plugin files
    trust_config: bool = False  # the settings may name programs and addresses


# In the process of the command.


@dataclass(frozen=True)
class Sweep:
    """How points are measured, and the folder that everything about it lies in."""

    root: Path
    job: Job  # what all measurements share
    threads: int | None = None  # None: as many as the libraries take by themselves
    seconds: float | None = (
        None  # no measurement starts after that much wall time; None: no limit
    )

    def image(self, key: str) -> Path:
        """Return the file of the novel view of one measurement."""
        return self.root / "pictures" / f"{key}.png"

    def key(self, settings: Mapping[str, Any], fingerprint: str) -> str:
        """Return a hash that is the same for measurements that would measure the same thing.

        It is of the point's settings, the scene's fingerprint, the number of runs, the threads and
        the versions of edit3r and torch.
        """
        versions = installed_versions()
        effort = (self.job.warm_up, self.job.repeats, self.threads)
        content = [
            settings,
            fingerprint,
            effort,
            [versions.get(name) for name in ("edit3r", "torch")],
        ]
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[
            :16
        ]

    def measure(
        self, points: Mapping[str, Mapping[str, Any]], scenes: Sequence[SceneFolder]
    ) -> list[dict[str, Any]]:
        """Measure all points (settings by label) on all scenes, each pair in a fresh process.

        What `measurements.jsonl` has from earlier sweeps is not measured again. Fewer measurements
        are returned if the time ran out.
        """
        fingerprints = [(scene, scene.fingerprint()) for scene in scenes]
        keyed = [
            (self.key(points[label], mark), label, scene)
            for label in points
            for scene, mark in fingerprints
        ]
        found = run_resumable(
            {key: (key, label, points[label], scene) for key, label, scene in keyed},
            self._measure_pair,
            self.root / "measurements.jsonl",
            seconds=self.seconds,
            on_done=lambda state: progress("measure", state.done, state.total),
        )
        labels = {key: label for key, label, _ in keyed}
        return [{**row, "label": labels[key]} for key, row in found.items()]

    def _measure_pair(
        self, pair: tuple[str, str, Mapping[str, Any], SceneFolder]
    ) -> dict[str, Any]:
        key, label, settings, scene = pair
        paths = {
            "scene": str(scene.path.resolve()),
            "image": str(self.image(key).resolve()),
        }
        return {
            "label": label,
            "settings": settings,
            "scene": scene.name,
            "kind": scene.kind,
            "threads": self.threads,
            "measured_at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            **in_fresh_process(
                replace(self.job, settings=settings, **paths), self.threads
            ),
        }


def in_fresh_process(job: Job, threads: int | None) -> Mapping[str, Any]:
    """Return the job's measurement, or the failure of a process that died."""
    limits = {} if threads is None else dict.fromkeys(THREAD_VARIABLES, str(threads))
    with tempfile.TemporaryDirectory() as work:
        task, answer = Path(work) / "job.json", Path(work) / "answer.json"
        task.write_text(json.dumps(asdict(job)), encoding="utf-8")
        command = [*PYTHON, "-m", __name__, str(task), str(answer)]
        ended = subprocess.run(
            command,
            env={**os.environ, **limits},
            capture_output=True,
            text=True,
            check=False,
        )
        if answer.is_file():
            return json.loads(answer.read_text(encoding="utf-8"))
    return {
        "failure": f"the process ended with {ended.returncode}: "
        f"{' '.join(ended.stderr.split())[-LAST_WORDS:]}"
    }


# In the process of one measurement.


def measure(job: Job) -> dict[str, Any]:
    """Return everything about the point on the scene, as JSON data; `failure` alone where it cannot
    be run.
    """
    scene, registry = SceneFolder.open(job.scene), default_registry(tuple(job.plugins))
    with tempfile.TemporaryDirectory() as work:
        try:
            runs = [
                _run(job, scene, job.settings, Path(work) / "run")
                for _ in range(job.warm_up + job.repeats)
            ]
            scores = _scores(job, scene, registry, Path(work))
        except RunError as failure:
            return {"failure": str(failure)}
    return {
        "runs": [
            {"warm_up": i < job.warm_up, **run["stages"]} for i, run in enumerate(runs)
        ],
        "memory_mb": max(run["memory_mb"] for run in runs),
        "start_memory_mb": runs[0]["start_memory_mb"],
        "gaussians": runs[-1]["gaussians"],
        "ply_bytes": runs[-1]["ply_bytes"],
        "repeatable": len({run["scene"] for run in runs}) == 1,
        **scores,
    }


def _run(
    job: Job, scene: SceneFolder, settings: Mapping[str, Any], out: Path
) -> dict[str, Any]:
    """Do one `edit3r run` in this process, which replaces the last one in `out`, and return what it
    tells.
    """
    # By their places, not by coverage: the target lies between them.
    photos = evenly(scene.photos, settings.get("views"))
    config = out.with_suffix(".yaml")
    config.write_text(yaml.safe_dump(dict(settings)), encoding="utf-8")
    argv = [
        "run",
        *map(str, photos),
        "--cameras",
        str(scene.cameras),
        "--config",
        str(config),
    ]
    argv += [
        "--out",
        str(out),
        "--quiet",
        *(part for file in job.plugins for part in ("--plugin", file)),
    ]
    if job.trust_config:
        argv.append("--trust-config")
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    with contextlib.redirect_stderr(io.StringIO()) as said:
        code = edit3r_command(argv)
    if code:
        raise RunError(" ".join(said.getvalue().split()).removeprefix("edit3r: "))
    run = RunFolder(out)
    told = json.loads(run.manifest.read_text(encoding="utf-8"))
    stages = told["stages"]
    return {
        "stages": {
            "cpu": {stage["name"]: stage["cpu_seconds"] for stage in stages},
            "wall": {stage["name"]: stage["seconds"] for stage in stages},
            "load": load,  # processes that wanted a core, last minute
        },
        "memory_mb": max(stage["peak_memory_mb"] for stage in stages),
        "start_memory_mb": stages[0]["peak_memory_mb"],
        "gaussians": told["gaussians"],
        "ply_bytes": run.scene.stat().st_size,
        "scene": hashlib.sha256(run.scene.read_bytes()).hexdigest(),
    }


def _scores(
    job: Job, scene: SceneFolder, registry: Registry, work: Path
) -> dict[str, Any]:
    """Score the novel view of a run without an edit, and the true edit where it is known."""
    unedited = merge(job.settings, job.unedited)
    if unedited != job.settings:
        _run(job, scene, unedited, work / "run")
    choice = make_run_config(unedited).rasterizer
    rasterizer = registry.build("rasterizer", choice.name, **choice.settings)
    view, (_, target) = _novel_view(work / "run", scene, rasterizer), scene.truth()
    scores = {
        "psnr": psnr(view.image, target.image),
        "ssim": ssim(view.image, target.image),
        "coverage": float(view.covered.mean()),
        **perceptual_distance(registry, job.perceptual, view.image, target.image),
    }
    Path(job.image).parent.mkdir(parents=True, exist_ok=True)
    save_image(torch.from_numpy(view.image).permute(2, 0, 1), job.image)
    if scene.edited is not None:
        folder = json.dumps(str(scene.edited))[1:-1]
        edited = json.loads(json.dumps(job.edited).replace("{folder}", folder))
        _run(job, scene, merge(job.settings, edited), work / "edited")
        after = _novel_view(work / "edited", scene, rasterizer)
        edit = score_edit(view, after, target, scene.truth(edited=True)[1])
        scores |= {"uptake": edit.uptake, "leak": edit.leak, "edited_psnr": edit.psnr}
    return scores


def _novel_view(
    folder: Path, scene: SceneFolder, rasterizer: Rasterizer
) -> RenderedView:
    """Render the target from the scene of a run, at the target's own size."""
    run = RunFolder(folder)
    cameras, posed = read_scene_cameras(run.cameras)
    inputs, target = scene.truth()
    names = [file.stem for file in scene.photos]
    used = [inputs[names.index(Path(camera.file).stem)] for camera in posed]
    return predict(
        Reconstruction(load_ply(run.scene), cameras),
        rasterizer,
        used[0],
        used[1],
        target,
    )


def perceptual_distance(
    registry: Registry,
    names: Sequence[str],
    image: Float[np.ndarray, "height width 3"],
    target: Float[np.ndarray, "height width 3"],
) -> dict[str, Any]:
    """Return the distance by the first of the losses that can be had here, its name, and what the
    others lack.
    """
    told: dict[str, Any] = {
        "perceptual": None,
        "perceptual_by": None,
        "perceptual_missing": {},
    }
    for name in names:
        try:
            loss = registry.build("loss", name)
        except MissingDependencyError as error:
            told["perceptual_missing"][name] = str(error)
            continue
        rendered, wished = (
            torch.from_numpy(x).permute(2, 0, 1)[None, None] for x in (image, target)
        )
        with torch.no_grad():
            distance = float(loss(LossInputs(rendered=rendered, target=wished)))
        return {**told, "perceptual": distance, "perceptual_by": name}
    return told


def main(job: str, answer: str) -> None:
    """Read a `Job` from one file and write its measurement to the other."""
    content = json.loads(Path(job).read_text(encoding="utf-8"))
    Path(answer).write_text(json.dumps(measure(Job(**content))), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
