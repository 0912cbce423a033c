"""What a tradeoff measured: the presets of `edit3r run --quality` and the tables."""

import os
import platform
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import yaml

from edit3r.contract.errors import Edit3rError, RunError
from edit3r.kit.command.results import grouped, markdown_table
from edit3r.kit.compute.lpips import lpips_weights
from edit3r.kit.provenance import installed_versions
from edit3r.running import PRESETS
from edit3r_measure.tradeoff_points import Expected, MeasuredPoint, Quality

# The numbers of this block: no figures kept.
# How many times as quick each preset is as the next, at least: the default lies between two.
APART = 1.5

Rows = Sequence[Mapping[str, Any]]
"""Lines of `measurements.jsonl`, with the labels of their points."""


# ---- points ----


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


# ---- presets ----


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


# ---- the table ----


def report(quality: Quality, rows: Rows) -> str:
    """Return all figures as Markdown: a table for each kind of scene, and what failed."""
    parts = [f"```yaml\n{yaml.safe_dump(quality.measured, sort_keys=False)}```"]
    for kind in quality.points[0].expected:
        scenes = dict.fromkeys(row["scene"] for row in rows if row["kind"] == kind)
        table = markdown_table([_cells(point, kind) for point in quality.points])
        parts.append(f"**{kind}** ({', '.join(scenes)})\n\n{table}")
    for row in rows:
        if "failure" in row:
            parts.append(f"{row['label']} failed on {row['scene']}: {row['failure']}")
    return "\n\n".join(parts) + "\n"


def _cells(point: MeasuredPoint, kind: str) -> dict[str, str]:
    figures = point.expected[kind]
    preset = f" ({point.preset})" if point.preset else ""
    return {
        "setting": point.label + preset,
        "processor s": f"{figures.seconds:.2f}",
        "first run": f"{figures.seconds_first:.2f}",
        "peak MiB": f"{figures.memory_mb:.0f}",
        "Gaussians": f"{figures.gaussians:,}",
        "PSNR [dB]": f"{figures.psnr:.2f}",
        "SSIM": f"{figures.ssim:.3f}",
        "LPIPS": "not measured" if figures.lpips is None else f"{figures.lpips:.3f}",
    }
