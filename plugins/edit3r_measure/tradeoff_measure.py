"""Measure the points of a tradeoff, each on each scene in a process of its own.

What is timed is a run from loaded photos to the last file written, several times in a row: the
first run of a process loads what the others find there. What is compared is a photo that lies
between the inputs and that no run is given.
"""

import hashlib
import json
import math
import multiprocessing
import os
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import torch

from edit3r import default_registry
from edit3r.contract.errors import Edit3rError
from edit3r.contract.reporting import Report, collecting, progress
from edit3r.contract.types import Reconstruction, Views
from edit3r.kit.children import SAFE_PATH, environment, restore_path, safe_path
from edit3r.kit.compute.lpips import lpips_weights
from edit3r.kit.provenance import installed_versions
from edit3r.kit.workers import run_resumable
from edit3r.running import RunJob, RunResult, make_run_config, run
from edit3r_measure.novel_view import novel_view
from edit3r_measure.scene_sources import EvaluationScene, SceneSource

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


@dataclass(frozen=True)
class PointJob:
    """One point on one scene; told to the process that measures it."""

    settings: Mapping[str, Any]  # run settings
    name: str  # of the scene
    scene: EvaluationScene
    repeats: int  # runs after the first one
    threads: int | None  # None: as many as the libraries take by themselves
    plugins: Sequence[str] = ()  # local plugin files

    @property
    def key(self) -> str:
        """A hash of all that a measurement depends on."""
        versions = installed_versions()
        effort = [self.repeats, self.threads, versions["edit3r"], versions["torch"]]
        effort.append(lpips_weights())
        text = json.dumps([self.settings, effort], sort_keys=True)
        digest = hashlib.sha256(text.encode())
        for photo in (*self.scene.inputs, self.scene.target):
            digest.update(photo.image.tobytes() + photo.c2w.tobytes())
        return digest.hexdigest()[:16]


def measure_points(
    points: Mapping[str, Mapping[str, Any]],
    sources: Sequence[SceneSource],
    out: Path,
    **effort: Any,
) -> list[dict[str, Any]]:
    """Measure all points (settings by label) on all scenes, and return a row of each; `effort` are
    the other fields of `PointJob`.

    What `measurements.jsonl` in `out` has from earlier is not measured again.
    """
    jobs = {}
    labels = {}
    for source in sources:
        scene = source.load()
        for label, settings in points.items():
            job = PointJob(settings, source.name, scene, **effort)
            jobs[job.key] = job
            labels[job.key] = label
    rows = run_resumable(
        jobs,
        in_fresh_process,
        out / "measurements.jsonl",
        on_done=lambda state: progress("measure", state.done, state.total),
    )
    return [{**row, "label": labels[key]} for key, row in rows.items()]


def in_fresh_process(job: PointJob) -> dict[str, Any]:
    """Return the job's row; `failure` in it where the point cannot be run, or the process died."""
    threads = dict.fromkeys(THREAD_VARIABLES, str(job.threads)) if job.threads else {}
    row = {
        "settings": job.settings,
        "scene": job.name,
        "kind": job.scene.kind,
        "day": datetime.now(timezone.utc).date().isoformat(),
    }
    spawn = multiprocessing.get_context("spawn")
    begin = (restore_path, (os.environ.get(SAFE_PATH),))
    with (
        safe_path(),
        environment(threads),
        ProcessPoolExecutor(1, spawn, *begin) as pool,
    ):
        try:
            return row | pool.submit(figures_of, job).result()
        except Edit3rError as error:
            return row | {"failure": str(error)}
        except BrokenProcessPool:
            return row | {"failure": "the process died: out of memory, or a crash."}


def figures_of(job: PointJob) -> dict[str, Any]:
    """Return what the point takes and gives on the scene."""
    settings = {"editor": "none", **job.settings}
    size = settings.pop("size")
    config = make_run_config(settings)
    registry = default_registry(tuple(job.plugins))
    runs: list[RunResult] = []

    @torch.enable_grad()
    def reconstruct(views: Views) -> Reconstruction:
        """Do as `edit3r run` does, several times; all times leave the same scene."""
        scale = min(1.0, size / max(views.image_size))
        small = views.at(tuple(round(scale * side) for side in views.image_size))
        small = replace(small, names=("first", "second"))
        for _ in range(1 + job.repeats):
            runs.append(run(RunJob(config, small), registry, Report()))
            with tempfile.TemporaryDirectory() as work, collecting(runs[-1].report):
                runs[-1].save(Path(work) / "run")
        return Reconstruction(runs[-1].gaussians, runs[-1].cameras)

    rasterizer = registry.build_choice("rasterizer", config.rasterizer)
    figures = novel_view(reconstruct, rasterizer, job.scene)
    stages = [one.report.stages for one in runs]
    seconds = [sum(stage.cpu_seconds for stage in own) for own in stages]
    return {
        "seconds": seconds[1:],
        "seconds_first": seconds[0],
        "memory_mb": stages[-1][-1].peak_memory_mb,
        "gaussians": runs[-1].gaussians.count,
        "psnr": figures["psnr"],
        "ssim": figures["ssim"],
        "lpips": None if math.isnan(figures["lpips"]) else figures["lpips"],
    }
