"""Plots of a report: what each method gives, and what it costs. Needs matplotlib (extra `bench`)."""

from collections.abc import Sequence
from pathlib import Path

from edit3r.io.atomic import atomic_write
from edit3r.reporting import warn
from edit3r_measure.bench.summary import Column, mean_of, metric_names, timing

__all__ = ["write_plots"]

SHOWN = ("score", "psnr-in-edit", "edit-uptake", "consistency-held-back", "clip-t2i", "c-kid", "c-kid-effnet")
PALETTE = ("#2f6f9f", "#d1782f", "#5b8c5a", "#8d6a9f", "#b8505c", "#6b6b6b", "#a08a3c", "#3f8f8a")


def write_plots(columns: Sequence[Column], out: Path) -> list[Path]:
    """Write measures.svg and quality-against-time.svg; none, with a warning, without matplotlib."""
    try:
        import matplotlib
    except ImportError:
        warn('no plots: matplotlib is not installed; install with: pip install "edit3r[bench]"')
        return []
    with matplotlib.rc_context({"svg.hashsalt": "edit3r", "font.size": 9}):
        return [_measures(columns, out / "measures.svg"), _quality_against_time(columns, out / "quality-time.svg")]


def _measures(columns: Sequence[Column], path: Path) -> Path:
    """One panel a measure, one bar a method, whiskers the 95 % interval."""
    from matplotlib.figure import Figure

    names = [name for name in SHOWN if name in metric_names(columns)]
    figure = Figure(figsize=(2.3 * len(names), 2.8), layout="constrained")
    for panel, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names):
        for place, column in enumerate(columns):
            mean = mean_of(column, name)
            if mean is not None:
                reach = [[mean.mean - mean.low], [mean.high - mean.mean]]
                panel.bar(place, mean.mean, yerr=reach, color=PALETTE[place % len(PALETTE)], capsize=3, width=0.7)
        panel.set_title(name, fontsize=9)
        panel.set_xticks(range(len(columns)), [column.label for column in columns], rotation=40, ha="right")
        panel.spines[["top", "right"]].set_visible(False)
    return _save(figure, path)


def _quality_against_time(columns: Sequence[Column], path: Path) -> Path:
    """Score over CPU seconds of a warm edit, time on a logarithmic axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6, 3.2), layout="constrained")
    panel = figure.subplots()
    for place, column in enumerate(columns):
        warm, mean = timing(column)["warm"], mean_of(column, "score")
        if warm is None or mean is None:
            continue
        seconds = warm["editor_cpu"] + warm["network_cpu"]
        reach = [[mean.mean - mean.low], [mean.high - mean.mean]]
        panel.errorbar(seconds, mean.mean, yerr=reach, fmt="o", color=PALETTE[place % len(PALETTE)], capsize=3)
        panel.annotate(f" {column.label}", (seconds, mean.mean), fontsize=8, va="bottom")
    panel.set_xscale("log")
    panel.margins(x=0.25)
    panel.set_xlabel("editing and reconstructing a scene, warm [s CPU]")
    panel.set_ylabel("score")
    panel.spines[["top", "right"]].set_visible(False)
    return _save(figure, path)


def _save(figure, path: Path) -> Path:
    with atomic_write(path) as partial:
        figure.savefig(partial, metadata={"Date": None})
    return path
