"""The table of a sweep with the words around it, in Markdown, and its plot: time against
accuracy.
"""

import math
import os
import platform
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from edit3r.errors import MissingDependencyError
from edit3r.io.atomic import write_between
from edit3r.io.run_folder import installed_versions
from edit3r_measure.report import format_or_dash, markdown_table
from edit3r_measure.tradeoff_knobs import BASE
from edit3r_measure.tradeoff_points import Figures, MeasuredPoint, Spread, front

START, END = (
    "<!-- tradeoff: written by edit3r tradeoff --page -->",
    "<!-- end of tradeoff -->",
)
STAGES = ("reconstruct", "simplify", "refine", "render", "write files")
CLOCKS = {"cpu": "processor time", "wall": "time"}
PANEL, LINE = (
    260,
    9,
)  # about the height of all points, and of a line of text [typographic points]
NAMES = 0.6  # room for names, left of the points, against the width of these


def report(
    points: Sequence[MeasuredPoint],
    measurements: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    clock: str,
    presets: Mapping[str, str],
) -> str:
    """Return everything that a sweep found; `presets` is label to preset."""
    parts = [_statement(measurements, measured, clock)]
    for kind in points[0].kinds if points else ():
        scenes = list(
            dict.fromkeys(m["scene"] for m in measurements if m["kind"] == kind)
        )
        parts.append(
            f"**{kind}** ({', '.join(scenes)})\n\n{_table(points, kind, clock, presets)}"
        )
    parts.append("\n".join(_remarks(measurements)))
    return "\n\n".join(parts) + "\n"


def write_into_page(page: Path, text: str, plotted: Path) -> None:
    """Write the report between the markers of a page, and the plot, if there is one, to images/
    beside the page.

    Raises InputError when the page has no markers.
    """
    image = f"images/{page.stem}.png"
    if plotted.is_file():
        (page.parent / "images").mkdir(exist_ok=True)
        shutil.copyfile(plotted, page.parent / image)
        text = f"![Novel-view PSNR against time, front and presets]({image})\n\n{text}"
    write_between(page, START, END, text)


def describe_machine(threads: int | None) -> dict[str, Any]:
    """Return processor, cores, threads and versions as JSON data, as far as they can be told."""
    table = Path("/proc/cpuinfo")
    found = (
        re.search(r"model name\s*: (.+)", table.read_text())
        if table.is_file()
        else None
    )
    versions = installed_versions()
    return {
        "processor": found[1] if found else platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads": threads or "as the libraries choose",
        "versions": {
            name: versions[name]
            for name in ("edit3r", "python", "torch", "numba")
            if name in versions
        },
    }


def _statement(
    measurements: Sequence[Mapping[str, Any]], measured: Mapping[str, Any], clock: str
) -> str:
    """Return a paragraph on the machine, how busy it was, and the command."""
    versions = ", ".join(
        f"{name} {version}" for name, version in measured["versions"].items()
    )
    runs = [
        run for m in measurements for run in m.get("runs", ()) if not run["warm_up"]
    ]
    loads = [run["load"] for run in runs if run["load"] is not None]
    waited = [
        sum(run["wall"].values()) / max(sum(run["cpu"].values()), 1e-9) for run in runs
    ]
    busy = f"; 1-minute load {median(loads):.1f} in the median" if loads else ""
    shared = (
        f", wall time {median(waited):.2f} times the processor time in the median"
        if waited
        else ""
    )
    days = sorted({m["measured_at"][:10] for m in measurements})
    return (
        f"{measured['processor']}, {measured['cores']} cores, threads: {measured['threads']}; "
        f"{versions}; "
        f"{' to '.join(dict.fromkeys((days[0], days[-1]))) if days else 'nothing measured'}{busy}{shared}. "
        f"Ranked by {'processor' if clock == 'cpu' else 'wall'} time, that of the quickest repeat; "
        f"measured by `{measured['command']}`."
    )


def _table(
    points: Sequence[MeasuredPoint], kind: str, clock: str, presets: Mapping[str, str]
) -> str:
    rows = sorted(points, key=lambda p: p.kinds[kind].seconds(clock))
    figures = [point.kinds[kind] for point in rows]
    on_front = front([f.seconds(clock) for f in figures], [f.psnr for f in figures])
    stages = [name for name in STAGES if any(name in f.stages for f in figures)]
    cells = [
        [
            point.label,
            presets.get(point.label, ""),
            "yes" if on else "",
            *_cells(f, stages).values(),
        ]
        for point, f, on in zip(rows, figures, on_front)
    ]
    return markdown_table(
        ["setting", "preset", "front", *_cells(figures[0], stages)], cells, left=3
    )


def _cells(f: Figures, stages: Sequence[str]) -> dict[str, str]:
    """Return the columns of figures, by title."""
    return {
        "processor s": _seconds(f.cpu),
        "wall s": _seconds(f.wall),
        "first run, processor s": f"{f.first['cpu']:.2f}",
        **{f"{stage} s": f"{f.stages.get(stage, 0):.2f}" for stage in stages},
        "peak MiB": f"{f.memory_mb:.0f}",
        "Gaussians": f"{f.gaussians:,.0f}",
        "PLY MB": f"{f.ply_mb:.1f}",
        "PSNR dB (least to most)": f"{f.psnr:.2f} ({f.psnr_of_scenes.least:.2f} to "
        f"{f.psnr_of_scenes.most:.2f})",
        "SSIM": f"{f.ssim:.3f}",
        "perceptual": format_or_dash(f.perceptual, ".3f"),
        "dB to the best": format_or_dash(f.distance, ".1f"),
        "uptake": format_or_dash(f.uptake, ".2f"),
        "leak": format_or_dash(f.leak, ".4f"),
    }


def _seconds(spread: Spread) -> str:
    return f"{spread.middle:.2f} ({spread.least:.2f} to {spread.most:.2f})"


def _remarks(measurements: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say what the base is, what failed, what was not repeatable, and which perceptual distance it
    was.
    """
    base = next((m["settings"] for m in measurements if m["label"] == BASE), {})
    lines = [
        f"- {BASE}: {', '.join(f'{key} {value}' for key, value in base.items())}; others differ "
        "as they say."
    ]
    lines += [
        f"- {m['label']} failed on {m['scene']}: {m['failure']}"
        for m in measurements
        if "failure" in m
    ]
    odd = [m for m in measurements if not m.get("repeatable", True)]
    lines += [
        f"- {m['label']} on {m['scene']}: repeats did not leave the same scene."
        for m in odd
    ]
    used = {m["perceptual_by"] for m in measurements if m.get("perceptual_by")}
    if used:
        lines.append(
            f"- Perceptual distance: the loss {' and '.join(sorted(used))}; smaller is closer."
        )
    missing = {
        name: why
        for m in measurements
        for name, why in m.get("perceptual_missing", {}).items()
    }
    return lines + [
        f"- No perceptual distance by {name}: {why}"
        for name, why in sorted(missing.items())
    ]


# The plot.


def plot(
    points: Sequence[MeasuredPoint], clock: str, presets: Mapping[str, str], file: Path
) -> None:
    """Write a panel for each kind of scene; `presets` is label to preset.

    Raises MissingDependencyError without matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError(
            "the plot needs matplotlib; install with: pip install matplotlib"
        ) from None
    kinds = list(points[0].kinds)
    figure = Figure(figsize=(6.5 * len(kinds), 5), layout="constrained")
    for axis, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds):
        _draw_panel(axis, points, kind, clock, presets)
    figure.savefig(file, dpi=110)


def _draw_panel(
    axis: Any,
    points: Sequence[MeasuredPoint],
    kind: str,
    clock: str,
    presets: Mapping[str, str],
) -> None:
    times = [getattr(p.kinds[kind], clock) for p in points]
    accuracies = [p.kinds[kind].psnr for p in points]
    on_front = front([t.least for t in times], accuracies)
    line = sorted(
        (t.least, a, p.label)
        for p, t, a, on in zip(points, times, accuracies, on_front)
        if on
    )
    axis.step(
        *list(zip(*line))[:2],
        where="post",
        color="tab:blue",
        linewidth=1,
        label="front",
    )
    for point, time, accuracy, on in zip(points, times, accuracies, on_front):
        preset = presets.get(point.label)
        look = (
            {"fmt": "*", "ms": 15, "color": "tab:red"}
            if preset
            else {"fmt": "o", "ms": 5}
        )
        spread = [[0], [time.most - time.least]]
        axis.errorbar(
            time.least,
            accuracy,
            xerr=spread,
            lw=1,
            **{"color": "tab:blue" if on else "0.6", **look},
        )
    _label_axes(
        axis, kind, clock, min(t.least for t in times), max(t.most for t in times)
    )
    _name_points(axis, line, presets, max(accuracies) - min(accuracies))


def _label_axes(
    axis: Any, kind: str, clock: str, quickest: float, slowest: float
) -> None:
    """Make the axis of times [s] logarithmic, with room for names on the left."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    time = f"{CLOCKS[clock]} of a run without an editor, quickest to slowest repeat [s]"
    axis.set(xscale="log", xlabel=time, ylabel="novel view PSNR [dB]", title=kind)
    axis.margins(y=0.1)
    axis.set_xlim(quickest * (quickest / slowest) ** NAMES, slowest * 1.3)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: f"{seconds:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right", fontsize=8)


def _name_points(
    axis: Any,
    on_front: Sequence[tuple[float, float, str]],
    presets: Mapping[str, str],
    span: float,
) -> None:
    """Write the names of (seconds, dB, label), quickest first, to the left, where no point can be,
    and none on another.

    Points off the front are named in the table.
    """
    top = -math.inf
    for index, (seconds, accuracy, label) in enumerate(on_front):
        preset = presets.get(label)
        at = accuracy / max(span, 1e-9) * PANEL  # [typographic points]
        top = max(at + 3, top + LINE)
        axis.annotate(
            f"{preset}: {label}" if preset else label,
            (seconds, accuracy),
            xytext=(10 if index == 0 else -8, top - at),
            textcoords="offset points",
            ha="left" if index == 0 else "right",
            fontsize=7,
            color="tab:red" if preset else "tab:blue",
        )
