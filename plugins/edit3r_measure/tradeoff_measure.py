"""Measure the points of a tradeoff, each on each scene in a process of its own, and choose presets.

What is timed is a run from loaded photos to the last file written, several times in a row: the
first run of a process loads what the others find there. What is compared is a photo that lies
between the inputs and that no run is given.
"""

import hashlib
import json
import math
import multiprocessing
import os
import platform
import re
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from edit3r import default_registry
from edit3r.contract.errors import Edit3rError, RunError
from edit3r.contract.reporting import Report, collecting, progress
from edit3r.contract.types import Reconstruction, Views
from edit3r.kit.children import SAFE_PATH, environment, restore_path, safe_path
from edit3r.kit.command.results import grouped, markdown_table
from edit3r.kit.compute.lpips import lpips_weights
from edit3r.kit.provenance import installed_versions
from edit3r.kit.workers import run_resumable
from edit3r.running import PRESETS, RunJob, RunResult, make_run_config, run
from edit3r_measure.novel_view import novel_view
from edit3r_measure.scene_sources import EvaluationScene, SceneSource
from edit3r_measure.tradeoff_points import Expected, MeasuredPoint, Quality

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


# ---- points and presets ----

# The numbers of this block: no figures kept.
# How many times as quick each preset is as the next, at least: the default lies between two.
APART = 1.5

Rows = Sequence[Mapping[str, Any]]
"""Lines of `measurements.jsonl`, with the labels of their points."""


def summarize(rows: Rows, effort: Mapping[str, Any]) -> Quality:
    """The points that were measured, on which machine, with what `effort`. Raises RunError."""
    points = measured_points(rows)
    if not points:
        failures = dict.fromkeys(row.get("failure", "") for row in rows)
        raise RunError(f"no point could be run on every scene. {' '.join(failures)}")
    versions = installed_versions()
    table = Path("/proc/cpuinfo")
    about = table.read_text(encoding="utf-8") if table.is_file() else ""
    model = re.search(r"model name\s*: (.+)", about)
    machine = {
        "processor": model[1] if model else platform.processor(),
        "cores": os.cpu_count(),
        "day": max(row["day"] for row in rows),
        "versions": {name: versions[name] for name in ("edit3r", "python", "torch")},
        "lpips": lpips_weights() or "not measured",
    }
    return Quality(measured={**machine, **effort}, points=points)


def measured_points(rows: Rows) -> list[MeasuredPoint]:
    """The points that were measured on every scene and never failed, quickest first."""
    scenes = {row["scene"] for row in rows}
    points = []
    for label, group in grouped(rows, lambda row: row["label"]).items():
        done = [row for row in group if "failure" not in row]
        if {row["scene"] for row in done} == scenes:
            kinds = grouped(done, lambda row: row["kind"])
            expected = {kind: _expected(own) for kind, own in kinds.items()}
            settings = group[0]["settings"]
            points.append(
                MeasuredPoint(label=label, settings=settings, expected=expected)
            )
    presets = {point.label: preset for preset, point in choose_presets(points).items()}
    named = [
        point.model_copy(update={"preset": presets.get(point.label)})
        for point in points
    ]
    return sorted(named, key=lambda point: point.seconds)


def _expected(rows: Rows) -> Expected:
    """Return the figures of a point on one kind of scene, as they are written to the file."""
    quickest = fmean(min(row["seconds"]) for row in rows)
    distances = [row["lpips"] for row in rows if row["lpips"] is not None]
    return Expected(
        seconds=round(quickest, 3),
        seconds_first=round(fmean(row["seconds_first"] for row in rows), 3),
        memory_mb=round(max(row["memory_mb"] for row in rows)),
        gaussians=max(row["gaussians"] for row in rows),
        psnr=round(fmean(row["psnr"] for row in rows), 2),
        ssim=round(fmean(row["ssim"] for row in rows), 4),
        lpips=round(fmean(distances), 4) if distances else None,
    )


def choose_presets(
    points: Sequence[MeasuredPoint], apart: float = APART
) -> dict[str, MeasuredPoint]:
    """Return the presets by name, by the means over all kinds of scene; empty where no three points
    lie apart.

    `best` is the most accurate point at the largest size of photos, `balanced` the most accurate
    one that costs at most 1/`apart` of it, and `fast` the same below `balanced`.
    """
    if not points:
        return {}
    largest = max(point.settings.get("size", 0) for point in points)
    full = [p for p in points if p.settings.get("size", 0) == largest]
    best = max(full, key=lambda point: point.accuracy)
    balanced = _most_accurate_below(best, points, apart)
    fast = balanced and _most_accurate_below(balanced, points, apart)
    return dict(zip(PRESETS, (fast, balanced, best))) if fast and balanced else {}


def _most_accurate_below(
    slower: MeasuredPoint, points: Sequence[MeasuredPoint], apart: float
) -> MeasuredPoint | None:
    """The most accurate point that costs at most 1/`apart` of `slower`, over all scenes."""
    quick = [point for point in points if apart * _seconds(point) <= _seconds(slower)]
    return max(quick, key=lambda point: point.accuracy, default=None)


def _seconds(point: MeasuredPoint) -> float:
    return sum(own.seconds for own in point.expected.values())


def write_presets(quality: Quality) -> Path:
    """Write the file of `edit3r run --quality`. Raises Edit3rError where there are no presets."""
    if not any(point.preset for point in quality.points):
        raise Edit3rError(
            f"the presets stay as they are: no three points lie {APART:g} times apart in time."
        )
    return quality.write()


def report(quality: Quality, rows: Rows) -> str:
    """All figures as a Markdown table, a row for each point and kind of scene, and what failed."""
    cells = [
        _cells(point, kind)
        for kind in quality.points[0].expected
        for point in quality.points
    ]
    failed = [
        f"- {row['label']} failed on {row['scene']}: {row['failure']}\n"
        for row in rows
        if "failure" in row
    ]
    return f"{markdown_table(cells, left=2)}\n\n{''.join(failed)}"


def _cells(point: MeasuredPoint, kind: str) -> dict[str, str]:
    figures = point.expected[kind]
    preset = f" ({point.preset})" if point.preset else ""
    return {
        "scenes": kind,
        "setting": point.label + preset,
        "processor s": f"{figures.seconds:.2f}",
        "first run": f"{figures.seconds_first:.2f}",
        "peak MiB": f"{figures.memory_mb:.0f}",
        "Gaussians": f"{figures.gaussians:,}",
        "PSNR [dB]": f"{figures.psnr:.2f}",
        "SSIM": f"{figures.ssim:.3f}",
        "LPIPS": "not measured" if figures.lpips is None else f"{figures.lpips:.3f}",
    }
