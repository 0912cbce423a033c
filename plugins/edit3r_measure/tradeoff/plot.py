"""The picture of a sweep: time against accuracy, a panel for each kind of scene."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edit3r.errors import MissingDependencyError
from edit3r_measure.tradeoff.figures import MeasuredPoint
from edit3r_measure.tradeoff.front import front

CLOCKS = {"cpu": "processor time", "wall": "time"}
PANEL, LINE = 260, 9  # about the height of all points, and of a line of text [typographic points]
NAMES = 0.6  # room for names, left of the points, against the width of these


def plot(points: Sequence[MeasuredPoint], clock: str, presets: Mapping[str, str], file: Path) -> None:
    """Write the plot; `presets` is label to preset. Raises MissingDependencyError without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingDependencyError("the plot needs matplotlib; install with: pip install matplotlib") from None
    kinds = list(points[0].kinds)
    figure = Figure(figsize=(6.5 * len(kinds), 5), layout="constrained")
    for axis, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds):
        _panel(axis, points, kind, clock, presets)
    figure.savefig(file, dpi=110)


def _panel(axis: Any, points: Sequence[MeasuredPoint], kind: str, clock: str, presets: Mapping[str, str]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    times = [getattr(p.kinds[kind], clock) for p in points]
    accuracies = [p.kinds[kind].psnr for p in points]
    on_front = front([t.least for t in times], accuracies)
    axis.set(
        xscale="log",
        xlabel=f"{CLOCKS[clock]} of a run without an editor, quickest to slowest repeat [s]",
        ylabel="novel view PSNR [dB]",
        title=kind,
    )
    line = sorted((t.least, a, p.label) for p, t, a, on in zip(points, times, accuracies, on_front) if on)
    axis.step(*list(zip(*line))[:2], where="post", color="tab:blue", linewidth=1, label="front")
    for point, time, accuracy, on in zip(points, times, accuracies, on_front):
        preset = presets.get(point.label)
        around = [[0], [time.most - time.least]]
        colour = "tab:red" if preset else "tab:blue" if on else "0.6"
        axis.errorbar(
            time.least, accuracy, xerr=around, fmt="*" if preset else "o", ms=15 if preset else 5, color=colour, lw=1
        )
    axis.margins(y=0.1)
    quickest, slowest = min(t.least for t in times), max(t.most for t in times)
    axis.set_xlim(quickest * (quickest / slowest) ** NAMES, slowest * 1.3)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: f"{seconds:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right", fontsize=8)
    _name(axis, line, presets, max(accuracies) - min(accuracies))


def _name(axis: Any, named: Sequence[tuple[float, float, str]], presets: Mapping[str, str], span: float) -> None:
    """Write the front's names, quickest first, to its left, where no point can be, and none on another.

    The others' names are in the table.
    """
    top = -math.inf
    for index, (seconds, accuracy, label) in enumerate(named):
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
