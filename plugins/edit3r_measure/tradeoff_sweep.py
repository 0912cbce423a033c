"""Measure every point on every scene, each in a fresh process, and keep what was measured: a sweep can be killed.

A measurement counts for a later sweep when its key is the same: a hash of the point's settings, the scene's images and
poses, the number of runs, the threads and the versions of edit3r and torch.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from edit3r.errors import InputError
from edit3r.io.manifest import installed_versions
from edit3r.registry import Registry
from edit3r.reporting import progress
from edit3r_measure.runner import run_resumable
from edit3r_measure.scene_sources import NO_TRIPLES, SceneFolder, SceneOptions, find_scenes, write_scene
from edit3r_measure.tradeoff_knobs import Point, SweepPlan
from edit3r_measure.tradeoff_measure import Job

__all__ = ["Effort", "SweepFolder", "measurement_key", "sweep", "write_scenes"]

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
LAST_WORDS = 300  # characters of a dead process's last words that are kept


@dataclass(frozen=True)
class SweepFolder:
    """Where everything about a sweep lies."""

    root: Path

    @property
    def measurements(self) -> Path:
        return self.root / "measurements.jsonl"

    @property
    def table(self) -> Path:
        return self.root / "tradeoff.md"

    @property
    def plot(self) -> Path:
        return self.root / "tradeoff.png"

    def image(self, key: str) -> Path:
        """Return the file of the novel view of one measurement."""
        return self.root / "pictures" / f"{key}.png"


@dataclass(frozen=True)
class Effort:
    """How each point is measured."""

    warm_up: int = 1
    repeats: int = 3
    threads: int | None = None  # None: as many as the libraries take by themselves
    seconds: float | None = None  # no measurement starts after that much wall time; None: no limit


def write_scenes(
    sources: Sequence[str], plan: SweepPlan, count: int, folder: SweepFolder, registry: Registry
) -> list[SceneFolder]:
    """Write up to `count` scenes of each source that are not written yet. Raises InputError for one without scenes."""
    options = SceneOptions(count, plan.side, plan.datasets, more_inputs=True)
    written = []
    for source in sources:
        scenes = [scene for scene in find_scenes(source, options, registry) if scene.has_target]
        if not scenes:
            raise InputError(f"{source}: {NO_TRIPLES}.")
        written += [write_scene(scene, folder.root / "scenes") for scene in scenes]
    return written


def sweep(
    plan: SweepPlan,
    points: Sequence[Point],
    scenes: Sequence[SceneFolder],
    folder: SweepFolder,
    effort: Effort,
    plugins: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Return measurements of all points on all scenes, those of earlier sweeps included; fewer if the time ran out."""
    fingerprints = {scene.path: scene.fingerprint() for scene in scenes}
    pairs = [(point, scene) for point in points for scene in scenes]
    jobs = {measurement_key(point, fingerprints[scene.path], effort): (point, scene) for point, scene in pairs}

    def measure_pair(key: str) -> dict[str, Any]:
        point, scene = jobs[key]
        job = Job(
            scene=str(scene.path.resolve()),
            settings=point.settings,
            unedited=plan.unedited,
            edited=plan.edited,
            image=str(folder.image(key).resolve()),
            perceptual=plan.perceptual,
            warm_up=effort.warm_up,
            repeats=effort.repeats,
            plugins=[str(Path(file).resolve()) for file in plugins],
        )
        about = {"label": point.label, "settings": point.settings, "scene": scene.name, "kind": scene.kind}
        when = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        return {**about, "threads": effort.threads, "measured_at": when, **in_fresh_process(job, effort.threads)}

    found = run_resumable(
        {key: key for key in jobs},
        measure_pair,
        folder.measurements,
        seconds=effort.seconds,
        on_done=lambda state: progress("measure", state.done, state.total),
    )
    return [{**row, "label": jobs[key][0].label} for key, row in found.items()]


def measurement_key(point: Point, scene_fingerprint: str, effort: Effort) -> str:
    """Return a hash that is the same for measurements that would measure the same thing."""
    versions = installed_versions()
    content = [
        point.settings,
        scene_fingerprint,
        (effort.warm_up, effort.repeats, effort.threads),
        [versions.get(name) for name in ("edit3r", "torch")],
    ]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def in_fresh_process(job: Job, threads: int | None) -> Mapping[str, Any]:
    """Return the job's measurement, or the failure of a process that died."""
    limits = {} if threads is None else dict.fromkeys(THREAD_VARIABLES, str(threads))
    with tempfile.TemporaryDirectory() as work:
        task, answer = Path(work) / "job.json", Path(work) / "answer.json"
        task.write_text(json.dumps(asdict(job)), encoding="utf-8")
        command = [sys.executable, "-m", "edit3r_measure.tradeoff_measure", str(task), str(answer)]
        ended = subprocess.run(command, env={**os.environ, **limits}, capture_output=True, text=True, check=False)
        if answer.is_file():
            return json.loads(answer.read_text(encoding="utf-8"))
    return {"failure": f"the process ended with {ended.returncode}: {' '.join(ended.stderr.split())[-LAST_WORDS:]}"}
