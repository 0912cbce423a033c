"""What a tradeoff found: the Pareto front, the presets of `edit3r run --quality`, and the table."""

import os
import platform
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import yaml

from edit3r.contract.errors import Edit3rError, RunError
from edit3r.kit.command.results import grouped
from edit3r.kit.provenance import installed_versions
from edit3r.running import PRESETS, Expected, MeasuredPoint, Quality, write_quality
from edit3r_measure.lpips import lpips_weights

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
    found = re.search(
        r"model name\s*: (.+)",
        table.read_text(encoding="utf-8") if table.is_file() else "",
    )
    machine = {
        "processor": found[1] if found else platform.processor(),
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


# ---- the front and the presets ----


def front(costs: Sequence[float], accuracies: Sequence[float]) -> list[bool]:
    """Return for each point whether no other is at least as good in both and better in one (the
    Pareto front).

    A cost is better when it is smaller, an accuracy when it is larger. Points equal in both do not
    push each other out.
    """
    points = list(zip(costs, accuracies))

    def beats(a: tuple[float, float], b: tuple[float, float]) -> bool:
        return a[0] <= b[0] and a[1] >= b[1] and a != b

    return [not any(beats(other, point) for other in points) for point in points]


def on_front(points: Sequence[MeasuredPoint], kind: str) -> list[bool]:
    """Return for each point whether it is on the front of time and accuracy for a kind of scene."""
    figures = [point.expected[kind] for point in points]
    return front([own.seconds for own in figures], [own.accuracy for own in figures])


def choose_presets(
    points: Sequence[MeasuredPoint], apart: float = APART
) -> dict[str, MeasuredPoint]:
    """Return the presets by name, all of them on the front of every kind of scene; empty when there
    are no three such points.

    `best` is the most accurate point at the largest size of photos for which the other two exist.
    `balanced` is the most accurate point that costs at most 1/`apart` of it over all kinds of scene
    together, and `fast` the same below `balanced`.
    """
    if not points:
        return {}
    fronts = [on_front(points, kind) for kind in points[0].expected]
    candidates = [point for point, *flags in zip(points, *fronts) if all(flags)]
    sizes = [point.settings.get("size", 0) for point in points]
    full = [p for p in candidates if p.settings.get("size", 0) == max(sizes)]
    for best in sorted(full, key=lambda point: point.accuracy, reverse=True):
        balanced = _most_accurate_below(best, candidates, apart)
        fast = balanced and _most_accurate_below(balanced, candidates, apart)
        if fast is not None:
            return dict(zip(PRESETS, (fast, balanced, best)))
    return {}


def _most_accurate_below(
    slower: MeasuredPoint, points: Sequence[MeasuredPoint], apart: float
) -> MeasuredPoint | None:
    """The most accurate point that costs at most 1/`apart` of `slower`, over all scenes."""
    quick = [point for point in points if apart * _seconds(point) <= _seconds(slower)]
    return max(quick, key=lambda point: point.accuracy, default=None)


def _seconds(point: MeasuredPoint) -> float:
    return sum(own.seconds for own in point.expected.values())


def write_presets(quality: Quality) -> Path:
    """Write the file of `edit3r run --quality`. Raises Edit3rError where no presets were found."""
    if not any(point.preset for point in quality.points):
        raise Edit3rError(
            "the presets stay as they are: no three points on the front lie apart in time."
        )
    return write_quality(quality)


# ---- the table ----


HEAD = """\
| setting | preset | front | processor s | first run | peak MiB | Gaussians | PSNR dB | SSIM \
| LPIPS |
| --- | --- | --- | --: | --: | --: | --: | --: | --: | --: |"""


def report(quality: Quality, rows: Rows) -> str:
    """Return everything that was found, as Markdown."""
    points = quality.points
    parts = [
        f"```yaml\n{yaml.safe_dump(quality.measured, sort_keys=False)}```\n\n"
        "Processor time of the quickest run after the first of a process; the front is that of "
        "this time and LPIPS, or PSNR where LPIPS was not measured."
    ]
    for kind in points[0].expected:
        scenes = dict.fromkeys(row["scene"] for row in rows if row["kind"] == kind)
        lines = [f"**{kind}** ({', '.join(scenes)})\n", HEAD]
        for point, flag in zip(points, on_front(points, kind)):
            own = point.expected[kind]
            lines.append(
                f"| {point.label} | {point.preset or ''} | {'yes' if flag else ''} "
                f"| {own.seconds:.2f} | {own.seconds_first:.2f} | {own.memory_mb:.0f} "
                f"| {own.gaussians:,} | {own.psnr:.2f} | {own.ssim:.3f} "
                f"| {'not measured' if own.lpips is None else f'{own.lpips:.3f}'} |"
            )
        parts.append("\n".join(lines))
    for row in rows:
        if "failure" in row:
            parts.append(f"{row['label']} failed on {row['scene']}: {row['failure']}")
    return "\n\n".join(parts) + "\n"
