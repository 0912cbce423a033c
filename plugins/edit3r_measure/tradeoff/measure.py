"""Measure one point on one scene. Runs in a process of its own: `python -m edit3r_measure.tradeoff.measure JOB.json`.

What is timed is `edit3r run` itself, from the photos on disk to the last file written, as its `run.json` tells it. The
first runs warm the process up (compiled kernels, weights in the disk cache) and are recorded but not counted.
"""

import contextlib
import hashlib
import io
import json
import os
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from PIL import Image
from pydantic import Field

from edit3r.cli.main import main as edit3r_command
from edit3r.config import Settings, make_settings, merge
from edit3r.errors import RunError
from edit3r.io.run_folder import RunFolder
from edit3r.registry import Registry, default_registry
from edit3r.run_config import make_run_config
from edit3r_measure.tradeoff.accuracy import NovelView, PerceptualDistance, novel_view, score_edit, score_picture
from edit3r_measure.tradeoff.scenes import MeasuredScene, open_scene


class Job(Settings):
    """What the process is told."""

    scene: str = Field(description="scene folder")
    settings: dict[str, Any] = Field(description="run settings of the point")
    unedited: dict[str, Any] = Field(description="laid over them for the run compared with novel views")
    edited: dict[str, Any] = Field(description="laid over them to edit with true edits, {folder} is where they are")
    perceptual: list[str] = Field(default_factory=list, description="losses to try, in order")
    warm_up: int = Field(1, ge=0, description="runs before those that count")
    repeats: int = Field(3, ge=1, description="runs that count")
    plugins: list[str] = Field(default_factory=list, description="local plugin files")
    picture: str = Field(description="where to leave the novel view as PNG")
    answer: str = Field(description="where to write the measurement as JSON")


def measure(job: Job) -> dict[str, Any]:
    """Everything about the point on the scene, as JSON data; `failure` alone where it cannot be run."""
    scene, registry = open_scene(job.scene), default_registry(tuple(job.plugins))
    with tempfile.TemporaryDirectory() as work:
        try:
            runs = [_run(job, scene, job.settings, Path(work) / "run") for _ in range(job.warm_up + job.repeats)]
            scores = _scores(job, scene, registry, Path(work))
        except RunError as failure:
            return {"failure": str(failure)}
    counted = runs[job.warm_up :]
    return {
        "runs": [{"warm_up": i < job.warm_up, **run["stages"]} for i, run in enumerate(runs)],
        "memory_mb": max(run["memory_mb"] for run in runs),
        "start_memory_mb": runs[0]["start_memory_mb"],
        "gaussians": counted[-1]["gaussians"],
        "ply_bytes": counted[-1]["ply_bytes"],
        "repeatable": len({run["scene"] for run in runs}) == 1,
        **scores,
    }


def _run(job: Job, scene: MeasuredScene, settings: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """One `edit3r run` in this process, replacing the last one in `out`."""
    config = out.with_suffix(".yaml")
    config.write_text(yaml.safe_dump(dict(settings)), encoding="utf-8")
    argv = ["run", *map(str, scene.photos), "--cameras", str(scene.cameras), "--config", str(config)]
    argv += ["--out", str(out), "--quiet", *(part for file in job.plugins for part in ("--plugin", file))]
    said = io.StringIO()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    with contextlib.redirect_stderr(said):
        code = edit3r_command(argv)
    if code:
        raise RunError(" ".join(said.getvalue().split()).removeprefix("edit3r: "))
    return _what_it_tells(RunFolder(out), load)


def _what_it_tells(run: RunFolder, load: float | None) -> dict[str, Any]:
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


def _scores(job: Job, scene: MeasuredScene, registry: Registry, work: Path) -> dict[str, Any]:
    """Of the novel view without an edit, and of the true edit where it is known."""
    unedited = merge(job.settings, job.unedited)
    if unedited != job.settings:
        _run(job, scene, unedited, work / "run")
    choice = make_run_config(unedited).rasterizer
    rasterizer = registry.build("rasterizer", choice.name, **choice.settings)
    view, (_, target) = novel_view(work / "run", scene, rasterizer), scene.truth()
    perceptual = PerceptualDistance(registry, job.perceptual)
    scores: dict[str, Any] = score_picture(view, target)
    scores["perceptual"] = perceptual(view.image, target.image)
    scores["perceptual_by"] = perceptual.name
    scores["perceptual_missing"] = perceptual.why_not
    _save(view, Path(job.picture))
    if scene.edited is not None:
        _run(job, scene, merge(job.settings, _filled(job.edited, scene.edited)), work / "edited")
        after = novel_view(work / "edited", scene, rasterizer)
        edit = score_edit(view, after, target, scene.truth(edited=True)[1])
        scores |= {"uptake": edit.uptake, "leak": edit.leak, "edited_psnr": edit.psnr}
    return scores


def _filled(layer: Any, folder: Path) -> Any:
    """`{folder}` in any text of the layer becomes the path."""
    if isinstance(layer, Mapping):
        return {key: _filled(value, folder) for key, value in layer.items()}
    return layer.replace("{folder}", str(folder)) if isinstance(layer, str) else layer


def _save(view: NovelView, path: Path) -> None:
    """As 8-bit PNG, to compare settings with each other later."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.round(view.image * 255).astype(np.uint8)).save(path)


def main(argv: Sequence[str]) -> int:
    job = make_settings(Job, json.loads(Path(argv[0]).read_text(encoding="utf-8")), where="job")
    Path(job.answer).write_text(json.dumps(measure(job)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
