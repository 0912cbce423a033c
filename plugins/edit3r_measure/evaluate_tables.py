"""The figures of `edit3r evaluate` as tables and as JSON data."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from statistics import fmean, median
from typing import Any

from edit3r.kit.command.results import grouped, markdown_table
from edit3r_measure.novel_view import SceneScore
from edit3r_measure.protocol import AUC_DEGREES, CLASSES, NOT_CLASSED, auc

Scores = Sequence[SceneScore]


def as_records(scores: Scores) -> list[dict[str, Any]]:
    """Return JSON data, one mapping a pair; figures that are not known are null."""
    names = dict.fromkeys(name for score in scores for name in score.figures)
    records = []
    for score in scores:
        record = asdict(score)
        figures = record.pop("figures")
        for name in names:
            value = figures.get(name, math.nan)
            record[name] = None if math.isnan(value) else value
        records.append(record)
    return records


def as_markdown(scores: Scores) -> str:
    """Return the table of scores of one kind, followed by a line for each failure."""
    tables = {
        "novel view": novel_view_table,
        "edit": edit_table,
        "protocol": protocol_table,
    }
    lines = [tables[scores[0].kind](scores)]
    for score in scores:
        if score.failure:
            lines.append(
                f"- {score.scene}, {score.first} and {score.second}: {score.failure}"
            )
    if len(lines) > 1:
        lines.insert(1, "")
    return "\n".join(lines) + "\n"


def novel_view_table(scores: Scores) -> str:
    """Return one row a scene and one for all pairs: means over the pairs that did not fail."""
    groups = grouped(scores, lambda score: score.scene) | {"all pairs": list(scores)}
    rows = []
    for name, group in groups.items():
        done = _done(group)
        failed = len(group) - len(done)
        row = {"scene": name, "pairs": f"{len(group)}", "failed": f"{failed}"}
        rows.append(row | (_novel_view_cells(done) if done else {}))
    return markdown_table(rows)


def _novel_view_cells(pairs: Sequence[Mapping[str, float]]) -> dict[str, str]:
    mean = {name: fmean(pair[name] for pair in pairs) for name in pairs[0]}
    rotations = [pair["rotation_error"] for pair in pairs]
    covered_gain = mean["covered_psnr"] - mean["covered_blurred_psnr"]
    return {
        "PSNR": f"{mean['psnr']:.2f}",
        "best-blurred photo": f"{mean['blurred_psnr']:.2f}",
        "gain": f"{mean['psnr'] - mean['blurred_psnr']:+.2f}",
        "gain, covered pixels": f"{covered_gain:+.2f}",
        "SSIM gain": f"{mean['ssim'] - mean['blurred_ssim']:+.3f}",
        "coverage": f"{mean['coverage']:.3f}",
        "median rotation error": f"{median(rotations):.2f}°",
        "under 2°": f"{fmean(rotation < 2 for rotation in rotations):.0%}",
        "CPU s a pair": f"{mean['seconds']:.1f}",
    }


def edit_table(scores: Scores) -> str:
    """Return one row a measure of how edits are carried and fused."""
    done = _done(scores)
    rows = []
    for name in done[0] if done else ():
        values = [own[name] for own in done if not math.isnan(own[name])]
        row = {"carried edits": name, "scenes": f"{len(values)}"}
        if values:
            row |= {"mean": f"{fmean(values):.3f}", "median": f"{median(values):.3f}"}
        rows.append(row)
    return markdown_table(rows)


def protocol_table(scores: Scores) -> str:
    """A row a class of overlap and one for all pairs; failures count as infinite errors of pose."""
    names = next((list(score.figures) for score in scores if score.figures), [])
    groups = grouped(scores, lambda score: score.overlap) | {"all pairs": list(scores)}
    limits = "/".join(map(str, AUC_DEGREES))
    rows = []
    for kind in (*CLASSES, NOT_CLASSED, "all pairs"):
        own = groups.get(kind, [])
        if not own:
            continue
        done = _done(own)
        failed = len(own) - len(done)
        row = {"overlap": kind, "pairs": f"{len(own)}", "failed": f"{failed}"}
        for name in names:
            title = name.replace("_", " ")
            if name.endswith("pose_error"):
                degrees = [score.figures.get(name, math.inf) for score in own]
                areas = [f"{auc(degrees, limit):.2f}" for limit in AUC_DEGREES]
                row[f"AUC of {title} at {limits}°"] = " / ".join(areas)
            elif done:
                mean = fmean(figures[name] for figures in done)
                row[title] = f"{mean:.2f}" if "psnr" in name else f"{mean:.3f}"
        rows.append(row)
    return markdown_table(rows)


def _done(scores: Scores) -> list[Mapping[str, float]]:
    """Return the figures of the pairs that did not fail."""
    return [score.figures for score in scores if not score.failure]
