"""The picture of a sweep: time against accuracy, a panel for each kind of scene."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from edit3r.errors import MissingDependencyError
from edit3r.tradeoff.figures import MeasuredPoint
from edit3r.tradeoff.front import front

CLOCKS = {"cpu": "processor time", "wall": "time"}


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
    line = sorted((t.least, a) for t, a, on in zip(times, accuracies, on_front) if on)
    axis.step(*zip(*line), where="post", color="tab:blue", linewidth=1, label="front")
    for point, time, accuracy, on in zip(points, times, accuracies, on_front):
        preset = presets.get(point.label)
        around = [[0], [time.most - time.least]]
        colour = "tab:red" if preset else "tab:blue" if on else "0.6"
        axis.errorbar(
            time.least, accuracy, xerr=around, fmt="*" if preset else "o", ms=15 if preset else 5, color=colour, lw=1
        )
        text = f"{preset}: {point.label}" if preset else point.label
        left = time.least**2 > line[0][0] * line[-1][0]  # in the right half: towards the middle
        axis.annotate(
            text,
            (time.least, accuracy),
            xytext=(-6 if left else 6, 4 if on else -9),
            textcoords="offset points",
            ha="right" if left else "left",
            fontsize=7,
            color=colour if on or preset else "0.4",
        )
    axis.margins(x=0.2, y=0.1)
    axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda seconds, _: f"{seconds:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right", fontsize=8)
