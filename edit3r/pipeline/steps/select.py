"""Step 2: which views are used, and which of their pixels may change."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import EditsRegions, Reconstructor
from edit3r.contract.types import Views
from edit3r.contract.wishes import Thing, Wish
from edit3r.errors import InputError
from edit3r.geometry.maps import dilate_softly
from edit3r.pipeline.checks import component_name
from edit3r.pipeline.parts import Parts
from edit3r.pipeline.scene import Scene
from edit3r.reporting import stage, warn
from edit3r.selection.near_colour import near_colour
from edit3r.selection.regions import RegionFinder
from edit3r.selection.select import Selection, geometry_of


@torch.no_grad()
def select(scene: Scene, parts: Parts) -> Scene:
    """Which views are used, and which of their pixels may change."""
    with stage("load components"):
        scene, reconstructor = scene.to(parts.config.device), parts.reconstructor
        _require_enough(scene.start, reconstructor)
    with stage("select"):
        scene = _widened(_with_regions(scene, parts), parts)
        return _as_many_as_fit(scene, reconstructor)


def _require_enough(views: Views, reconstructor: Reconstructor) -> None:
    if views.count < reconstructor.min_views:
        raise InputError(
            f"{component_name(reconstructor)} needs at least {reconstructor.min_views} photos of "
            f"the same scene, got {views.count}; add photos taken from other places."
        )


def _as_many_as_fit(scene: Scene, reconstructor: Reconstructor) -> Scene:
    """As many views as the reconstructor takes: above its maximum they are evenly spaced."""
    count, most = scene.start.count, reconstructor.max_views
    if most is None or count <= most:
        return scene
    chosen = torch.linspace(0, count - 1, most).round().long().tolist()
    name = component_name(reconstructor)
    warn(f"{name} takes at most {most} views; of {count} these are used: {chosen}.")
    return scene.select(chosen)


def _with_regions(scene: Scene, parts: Parts) -> Scene:
    """The scene with a region for each wish, and their union as masks.

    An editor that takes any sentence is confined only by marks, or where a segmenter was asked for.
    """
    views = scene.start
    wishes = tuple(wish for task in parts.tasks for wish in task.wishes)
    if scene.masks is not None:
        expected = [*views.images.shape[:2], *views.image_size]
        if list(scene.masks.shape) != expected:
            raise InputError(
                f"masks: expected one per view at the views' size {expected}, got "
                f"{list(scene.masks.shape)}."
            )
        own = [_narrowed(scene.masks, views, wish.thing) for wish in wishes]
        return replace(scene, regions=torch.stack(own) if own else None)
    regional = any(isinstance(task.editor, EditsRegions) for task in parts.tasks)
    named = parts.chose_segmenter and any(
        wish.thing.scope == "named" for wish in wishes
    )
    if scene.marked is None and not regional and not named:
        return scene
    found = [
        _finder(views.scene(index), scene, parts).find(wishes or (MARKED,))
        for index in range(len(views.images))
    ]
    regions = torch.stack([one.masks for one in found], dim=1)
    masks = regions.amax(0)
    if not regional and scene.marked is None:  # words are less exact than marks
        masks = dilate_softly((masks > 0.5).to(masks).flatten(0, 1)).view_as(masks)
    return replace(
        scene,
        regions=regions if wishes else None,
        masks=None if bool((masks >= 1).all()) else masks,
        wishes=found[0].wishes if wishes else (),
        selected=found[0].selected,
        things=found[0].things,
    )


def _widened(scene: Scene, parts: Parts) -> Scene:
    """The scene with what editors have to change around the things, such as shadows."""
    if scene.regions is None or scene.masks is None:
        return scene
    of_tasks = scene.regions.split([len(task.wishes) for task in parts.tasks])
    regions = torch.cat(
        [
            task.editor.widened(own, scene.start.images)
            for task, own in zip(parts.tasks, of_tasks)
        ]
    )
    wide = torch.maximum(scene.masks, regions.amax(0))
    return replace(scene, regions=regions, masks=wide)


def _narrowed(
    masks: Float[Tensor, "batch view height width"], views: Views, thing: Thing
) -> Float[Tensor, "batch view height width"]:
    """Given masks; of "the red parts" only what is red."""
    if thing.part is None:
        return masks
    scenes = zip(masks, views.images)
    return torch.stack(
        [near_colour(mask, images, thing.part) for mask, images in scenes]
    )


MARKED = Wish("other", Thing("marked"))
"""The wish of a sentence that could not be read, or of none."""


def _finder(views: Views, scene: Scene, parts: Parts) -> RegionFinder:
    config = parts.config
    return RegionFinder(
        views,
        segmenter=lambda: parts.segmenter,
        geometry=lambda: geometry_of(parts.matcher, views),
        marked=scene.marked,
        defaults=Selection(
            guess=config.guess,
            larger=config.larger,
            grow=config.grow,
            inverted=config.invert,
        ),
        known=scene.things,
    )
