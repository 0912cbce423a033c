"""Step 3: which views are used, and which of their pixels may change."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import EditsRegions, Geometry, Reconstructor
from edit3r.contract.reporting import stage, warn
from edit3r.contract.types import Views
from edit3r.contract.wishes import Thing, Wish
from edit3r.kit.geometry.maps import dilate_softly
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene
from edit3r.running.selecting.near_colour import near_colour
from edit3r.running.selecting.regions import RegionFinder
from edit3r.running.selecting.select import Selection


@torch.no_grad()
def select(scene: Scene, parts: Parts) -> Scene:
    """Which views are used, and which of their pixels may change."""
    with stage("select"):
        scene = _widened(_with_regions(scene, parts), parts)
        return _as_many_as_fit(scene, parts.reconstructor)


def load(scene: Scene, parts: Parts) -> Scene:
    """The scene on the run's device, once its reconstructor takes so few photos."""
    with stage("load components"):
        _require_enough(scene.start, parts.reconstructor)
        return scene.to(parts.config.device)


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
    try:
        found = [
            _finder(index, scene, parts).find(wishes or (MARKED,))
            for index in range(len(views.images))
        ]
    except InputError as error:
        hints = "".join(parts.reader.hint(wish) for wish in wishes)
        if not hints:
            raise
        raise InputError(f"{error}{hints}") from None
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


def _finder(index: int, scene: Scene, parts: Parts) -> RegionFinder:
    """Finds things in one scene of the batch."""
    config = parts.config
    return RegionFinder(
        scene.start.scene(index),
        segmenter=lambda: parts.segmenter,
        geometry=lambda: _geometry(index, scene, parts),
        marked=scene.marked,
        defaults=Selection(
            guess=config.guess,
            sure=config.sure,
            reading=config.reading,
            larger=config.larger,
            grow=config.grow,
            inverted=config.invert,
        ),
        known=scene.things,
    )


def _geometry(index: int, scene: Scene, parts: Parts) -> Geometry | None:
    """What is known of one scene's unedited photos, where it can be trusted."""
    if scene.photos.count < 2:
        return None
    geometry = parts.geometry.of(scene.photos).trusted()
    return None if geometry is None else geometry.scene(index)
