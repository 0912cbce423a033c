"""The table and the words around it, as Markdown."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from edit3r.io.atomic import write_between
from edit3r_measure.tradeoff.figures import Figures, MeasuredPoint, Spread
from edit3r_measure.tradeoff.front import front
from edit3r_measure.tradeoff.knobs import BASE

START, END = "<!-- tradeoff: written by edit3r tradeoff --page -->", "<!-- end of tradeoff -->"
_STAGES = ("reconstruct", "simplify", "refine", "render", "write files")


def report(
    points: Sequence[MeasuredPoint],
    measurements: Sequence[Mapping[str, Any]],
    measured: Mapping[str, Any],
    clock: str,
    presets: Mapping[str, str],
) -> str:
    """Everything that a sweep found; `presets` is label to preset."""
    parts = [_statement(measurements, measured, clock)]
    for kind in points[0].kinds if points else ():
        scenes = list(dict.fromkeys(m["scene"] for m in measurements if m["kind"] == kind))
        parts.append(f"**{kind}** ({', '.join(scenes)})\n\n{_table(points, kind, clock, presets)}")
    parts += _remarks(measurements)
    return "\n\n".join(parts) + "\n"


def _statement(measurements: Sequence[Mapping[str, Any]], measured: Mapping[str, Any], clock: str) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in measured["versions"].items())
    runs = [run for m in measurements for run in m.get("runs", ()) if not run["warm_up"]]
    loads = [run["load"] for run in runs if run["load"] is not None]
    waited = [sum(run["wall"].values()) / max(sum(run["cpu"].values()), 1e-9) for run in runs]
    busy = f"; 1-minute load {median(loads):.1f} in the median" if loads else ""
    shared = f", wall time {median(waited):.2f} times the processor time in the median" if waited else ""
    days = sorted({m["measured_at"][:10] for m in measurements})
    return (
        f"{measured['processor']}, {measured['cores']} cores, threads: {measured['threads']}; {versions}; "
        f"{' to '.join(dict.fromkeys((days[0], days[-1]))) if days else 'nothing measured'}{busy}{shared}. "
        f"Ranked by {'processor' if clock == 'cpu' else 'wall'} time, that of the quickest repeat; "
        f"measured by `{measured['command']}`."
    )


def _table(points: Sequence[MeasuredPoint], kind: str, clock: str, presets: Mapping[str, str]) -> str:
    rows = sorted(points, key=lambda p: p.kinds[kind].seconds(clock))
    figures = [point.kinds[kind] for point in rows]
    on_front = front([f.seconds(clock) for f in figures], [f.psnr for f in figures])
    stages = [name for name in _STAGES if any(name in f.stages for f in figures)]
    titles = [
        "setting",
        "preset",
        "front",
        "processor s",
        "wall s",
        "first run, processor s",
        *(f"{s} s" for s in stages),
        "peak MiB",
    ]
    titles += [
        "Gaussians",
        "PLY MB",
        "PSNR dB (least to most)",
        "SSIM",
        "perceptual",
        "dB to the best",
        "uptake",
        "leak",
    ]
    lines = [_line(titles), _line(["---"] * 3 + ["--:"] * (len(titles) - 3))]
    for point, f, on in zip(rows, figures, on_front):
        cells = [point.label, presets.get(point.label, ""), "yes" if on else "", *_cells(f, stages)]
        lines.append(_line(cells))
    return "\n".join(lines)


def _cells(f: Figures, stages: Sequence[str]) -> list[str]:
    seconds = [f"{f.stages.get(name, 0):.2f}" for name in stages]
    spread = f.psnr_of_scenes
    picture = [f"{f.psnr:.2f} ({spread.least:.2f} to {spread.most:.2f})", f"{f.ssim:.3f}"]
    others = [
        _number(f.perceptual, ".3f"),
        _number(f.distance, ".1f"),
        _number(f.uptake, ".2f"),
        _number(f.leak, ".4f"),
    ]
    sizes = [f"{f.memory_mb:.0f}", f"{f.gaussians:,.0f}", f"{f.ply_mb:.1f}"]
    return [_seconds(f.cpu), _seconds(f.wall), f"{f.first['cpu']:.2f}", *seconds, *sizes, *picture, *others]


def _seconds(spread: Spread) -> str:
    return f"{spread.middle:.2f} ({spread.least:.2f} to {spread.most:.2f})"


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _remarks(measurements: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the base is, what failed, what was not repeatable, and which perceptual distance it was."""
    base = next((m["settings"] for m in measurements if m["label"] == BASE), {})
    lines = [f"- {BASE}: {', '.join(f'{key} {value}' for key, value in base.items())}; others differ as they say."]
    lines += [f"- {m['label']} failed on {m['scene']}: {m['failure']}" for m in measurements if "failure" in m]
    lines += [
        f"- {m['label']} on {m['scene']}: repeats did not leave the same scene."
        for m in measurements
        if not m.get("repeatable", True)
    ]
    used = {m["perceptual_by"] for m in measurements if m.get("perceptual_by")}
    if used:
        lines.append(f"- Perceptual distance: the loss {' and '.join(sorted(used))}; smaller is closer.")
    missing = {name: why for m in measurements for name, why in m.get("perceptual_missing", {}).items()}
    lines += [f"- No perceptual distance by {name}: {why}" for name, why in sorted(missing.items())]
    return ["\n".join(lines)]


def write_into_page(page: Path, text: str, picture: str | None) -> None:
    """Replace what stands between the markers of a page; raises InputError when it has none."""
    shown = f"![Novel-view PSNR against time, front and presets]({picture})\n\n" if picture else ""
    write_between(page, START, END, shown + text)
