"""The scenes of `edit3r evaluate`, measured, and their figures as tables and as JSON data."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from statistics import fmean, median
from typing import Any

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, track
from edit3r.contract.types import RENDERED
from edit3r.kit.checks import require_gives
from edit3r.kit.command.results import grouped, markdown_table
from edit3r.kit.reconstructing import WithMatcher
from edit3r_measure.evaluate_options import PARTS, Evaluation
from edit3r_measure.novel_view import (
    Measure,
    SceneScore,
    carried_edit,
    novel_view,
    score_scene,
)
from edit3r_measure.protocol import (
    AUC_DEGREES,
    CLASSES,
    NOT_CLASSED,
    PairProtocol,
    auc,
    index_scenes,
    read_index,
)
from edit3r_measure.scene_sources import SceneOptions, SceneSource, find_scenes

# Settings of data sets; the seeds of training are others
UNSEEN = {"procedural": {"seed": 1000, "targets": 1, "angles": [5, 25]}}


def measure(asked: Evaluation, registry: Registry, report: Report) -> list[SceneScore]:
    """Return the scores of all scenes that are asked for."""
    reconstructor, matcher, rasterizer = (
        registry.build_choice(kind, getattr(asked, kind)) for kind in PARTS
    )
    require_gives(rasterizer, asked.rasterizer.name, *RENDERED, who="evaluate")
    tools = WithMatcher(reconstructor, matcher), rasterizer
    find, kind = _scenes, "edit" if asked.edits else "novel view"
    figures: Measure = partial(carried_edit if asked.edits else novel_view, *tools)
    if asked.index:
        find, kind = _indexed_scenes, "protocol"
        distance = "lpips" if asked.lpips else "perceptual"
        loss = registry.build("loss", distance)
        figures = PairProtocol(*tools, distance, loss, asked.align)
    scores = []
    for place, scenes in find(asked, registry).items():
        with report.stage(place):
            for source in track(scenes, place):
                scene = source.load()
                if scene.edited or not asked.edits:
                    scores.append(score_scene(scene, kind, figures))
    if not scores:
        raise InputError(
            f"{asked.folders[0]}: no true edit is known; nothing to measure."
        )
    return scores


def _scenes(asked: Evaluation, registry: Registry) -> dict[str, list[SceneSource]]:
    """Return pairs of folders and scenes of data sets by place."""
    datasets = {}
    for place in asked.folders:
        settings = {}
        if place in UNSEEN:
            edit = "recolor" if asked.edits else "none"
            settings = {**UNSEEN[place], "image_size": asked.size, "edit": edit}
        datasets[place] = {**settings, **asked.dataset}
    which = SceneOptions(asked.pairs, asked.size, datasets)
    return {place: find_scenes(place, which, registry) for place in asked.folders}


def _indexed_scenes(
    asked: Evaluation, registry: Registry
) -> dict[str, list[SceneSource]]:
    """Return at most `pairs` of each scene and class of overlap in the index file."""
    settings = {"image_size": asked.size, **asked.dataset}
    scenes = [
        place if Path(place).is_dir() else registry.build("dataset", place, **settings)
        for place in asked.folders
    ]
    index = read_index(Path(asked.index))
    classes = grouped(index, lambda pair: f"{pair[0]} {pair[1].overlap_class}")
    pairs = [pair for own in classes.values() for pair in own[: asked.pairs]]
    return {asked.index: index_scenes(pairs, scenes, asked.size)}


# ---- figures ----

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
    table = TABLES[scores[0].kind](scores)
    failures = [
        f"- {score.scene}, {score.first} and {score.second}: {score.failure}\n"
        for score in scores
        if score.failure
    ]
    return f"{table}\n" + ("\n" + "".join(failures) if failures else "")


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
    return {
        "PSNR": f"{mean['psnr']:.2f}",
        "best-blurred photo": f"{mean['blurred_psnr']:.2f}",
        "gain": f"{mean['psnr'] - mean['blurred_psnr']:+.2f}",
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


TABLES = {
    "novel view": novel_view_table,
    "edit": edit_table,
    "protocol": protocol_table,
}
"""By kind of score."""
