"""The scenes of `edit3r evaluate`, measured."""

from functools import partial
from pathlib import Path

from edit3r import Registry
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, track
from edit3r.contract.types import RENDERED
from edit3r.kit.checks import require_gives
from edit3r.kit.command.results import grouped
from edit3r.kit.reconstructing import WithMatcher
from edit3r_measure.evaluate_options import PARTS, Evaluation
from edit3r_measure.novel_view import (
    Measure,
    SceneScore,
    carried_edit,
    novel_view,
    score_scene,
)
from edit3r_measure.protocol import PairProtocol, index_scenes, read_index
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
    if asked.index:
        kind = "protocol"
        distance = "lpips" if asked.lpips else "perceptual"
        loss = registry.build("loss", distance)
        figures: Measure = PairProtocol(*tools, distance, loss, asked.align)
        sources = _indexed_scenes(asked, registry)
    elif asked.edits:
        kind = "edit"
        figures = partial(carried_edit, *tools)
        sources = _scenes(asked, registry)
    else:
        kind = "novel view"
        figures = partial(novel_view, *tools)
        sources = _scenes(asked, registry)
    scores = []
    for place, scenes in sources.items():
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
