"""Step 3: which pixels of the photos may change, and how many photos are used."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError, QuestionError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import (
    ASK,
    EditsRegions,
    Geometry,
    Reconstructor,
    Selection,
    candidate_flags,
)
from edit3r.contract.reporting import Report, collecting, stage, warn
from edit3r.contract.types import Views
from edit3r.kit import asking
from edit3r.kit.geometry.maps import dilate_softly
from edit3r.kit.photos.images import evenly
from edit3r.running.components import Components
from edit3r.running.geometry import NOT_ASKED, GeometryAnswer, find_geometry
from edit3r.running.hiding import covering, without_candidates
from edit3r.running.records import Inputs, Located, Preview, SelectedRegions
from edit3r.running.scene_input import SceneInput
from edit3r.running.selecting.near_colour import near_colour
from edit3r.running.selecting.regions import RegionFinder

ASKED = 0.2
"""Confidence below which the thing that words name is asked about, and not edited: fitted with
places left out (`python benchmarks/clicks.py questions DATA`).
"""


@torch.no_grad()
def select(inputs: Inputs, located: Located, components: Components) -> SelectedRegions:
    """A mask for each instruction on every photo, and where anything may change at all.

    Geometry that nobody asked for yet is asked for where something is selected by it.
    """
    with stage("select"):
        selection = _regions(inputs, located, components)
        selection = _widened(selection, inputs, components)
        return selection if inputs.scene is None else _on_scene(selection, inputs.scene)


@torch.no_grad()
def require_known_words(inputs: Inputs, components: Components) -> None:
    """Raise QuestionError for words that nothing here knows, from the first photo alone: before
    geometry is read, which takes most of the time that a question would. A given scene has it.
    """
    marked = inputs.marked is not None or inputs.masks is not None
    named = any(
        target.scope == "named"
        for task in components.tasks
        for one in task.instructions
        for target in (one.target, *one.without)
    )
    alone = inputs.photos.count < 2 or inputs.scene is not None
    if marked or not named or alone or _guesses(components):
        return
    first = inputs.select([0])
    with stage("look up words"), collecting(Report()):
        selection = _regions(first, Located(), components)
    if not all(one.knows_words for one in selection.selected):
        require_answer(first, selection, components)


def _guesses(components: Components) -> bool:
    """Whether the likeliest candidate, or a numbered one, is taken without asking."""
    config = components.config
    return config.guess or "candidate" in config.set_by_the_user()


def require_answer(
    inputs: Inputs, selection: SelectedRegions, components: Components
) -> None:
    """Raise QuestionError where words hardly tell which thing is meant, and nobody chose one."""
    if _guesses(components):
        return
    for thing in selection.selected:
        by_words = {"words", "guess"} & {*thing.how}
        confidence = 1.0 if thing.confidence is None else thing.confidence
        if not thing.knows_words or (by_words and confidence < ASKED):
            flags = candidate_flags([one.number for one in thing.candidates])
            hints = "".join(
                asking.hint(components.reader, one) for one in selection.instructions
            )
            shown = inputs
            if components.hiding:
                shown = without_candidates(inputs, selection)
            things = tuple(replace(one, taken=0) for one in selection.selected)
            asks = (
                f"what is meant by {thing.called!r}"
                if thing.called
                else "what is meant"
            )
            raise QuestionError(
                f"{asks}? The likeliest candidate has a confidence "
                f"of {confidence:.0%}, so nothing was edited. Take one ({flags}), {ASK}, "
                "or fetch a detector that knows most words (edit3r weights get words); --guess "
                f"takes the likeliest.{hints}",
                thing.candidates,
                Preview(shown, replace(selection, selected=things), None),
            )


def as_many_as_fit(views: Views, reconstructor: Reconstructor) -> list[int]:
    """Indices of the views to use: all, or as many as the reconstructor takes, evenly spaced."""
    count, most = views.count, reconstructor.max_views
    if most is None or count <= most:
        return list(range(count))
    chosen = evenly(range(count), most)
    name = component_name(reconstructor)
    warn(f"{name} takes at most {most} views; of {count} these are used: {chosen}.")
    return chosen


def _regions(
    inputs: Inputs, located: Located, components: Components
) -> SelectedRegions:
    """A region for each instruction, and `masks`, all of them together.

    Nothing is looked for where the editor changes whole pictures by a sentence (one that is no
    `EditsRegions`): such an editor is kept to a region only where the user marked one, or chose a
    segmenter. Masks that the user gave are taken as they are.
    """
    views = inputs.start
    instructions = tuple(
        instruction for task in components.tasks for instruction in task.instructions
    )
    if inputs.masks is not None:
        expected = [*views.images.shape[:2], *views.image_size]
        if list(inputs.masks.shape) != expected:
            raise InputError(
                f"masks: expected one per view at the views' size {expected}, got "
                f"{list(inputs.masks.shape)}."
            )
        narrowed = [
            _narrowed(inputs.masks, views, instruction.target)
            for instruction in instructions
        ]
        return SelectedRegions(
            inputs.masks,
            torch.stack(narrowed) if narrowed else None,
            things=inputs.things,
        )
    regional = any(isinstance(task.editor, EditsRegions) for task in components.tasks)
    named = components.chose_segmenter and any(
        instruction.target.scope == "named" for instruction in instructions
    )
    if inputs.marked is None and not regional and not named:
        return SelectedRegions(things=inputs.things)
    marked_alone = any(one.target.scope == "marked" for one in instructions)
    if inputs.marked is None and marked_alone and not components.config.prompt:
        raise InputError(f"it is not clear which object is meant; {ASK}.")

    def hints() -> str:
        """What the reader of the sentence advises, such as "Did you mean 'bear'?"."""
        return "".join(asking.hint(components.reader, one) for one in instructions)

    geometry = _geometry(inputs.photos, located.answer, components)
    try:
        scenes = [
            _finder(index, inputs, geometry, components).find(instructions or (MARKED,))
            for index in range(len(views.images))
        ]
    except InputError as error:
        raise InputError(f"{error}{hints()}") from None
    is_guess = any("guess" in one.how for scene in scenes for one in scene.selected)
    if is_guess and (hint := hints().strip()):
        warn(hint)
    regions = torch.stack([one.masks for one in scenes], dim=1)
    masks = regions.amax(0)
    if not regional and inputs.marked is None:  # words are less exact than marks
        masks = dilate_softly((masks > 0.5).to(masks).flatten(0, 1)).view_as(masks)
    return SelectedRegions(
        masks=None if bool((masks >= 1).all()) else masks,
        regions=regions if instructions else None,
        instructions=scenes[0].instructions if instructions else (),
        selected=scenes[0].selected,
        chosen="candidate" in components.config.set_by_the_user(),
        things=scenes[0].things,
    )


def _widened(
    selection: SelectedRegions, inputs: Inputs, components: Components
) -> SelectedRegions:
    """The selection with what editors have to change around the things, such as shadows, and
    what has to be hidden around them.
    """
    if selection.regions is None:
        return selection
    of_tasks = selection.regions.split(
        [len(task.instructions) for task in components.tasks]
    )
    regions = torch.cat(
        [
            asking.widened(task.editor, region, inputs.start.images)
            for task, region in zip(components.tasks, of_tasks)
        ]
    )
    for hiding in components.hiding:
        regions[hiding] = covering(regions[hiding])
    if selection.masks is None:
        return replace(selection, regions=regions)
    wide = torch.maximum(selection.masks, regions.amax(0))
    return replace(selection, regions=regions, masks=wide)


def _on_scene(selection: SelectedRegions, scene: SceneInput) -> SelectedRegions:
    """The selection without what is background in the pictures of a given scene."""
    alphas = scene.views.scene.alphas
    masks, regions = selection.masks, selection.regions
    return replace(
        selection,
        masks=alphas if masks is None else masks * alphas,
        regions=None if regions is None else regions * alphas,
    )


def _narrowed(
    masks: Float[Tensor, "batch view height width"], views: Views, thing: Target
) -> Float[Tensor, "batch view height width"]:
    """Given masks; of "the red parts" only what is red."""
    if thing.part is None:
        return masks
    scenes = zip(masks, views.images)
    return torch.stack(
        [near_colour(mask, images, thing.part) for mask, images in scenes]
    )


MARKED = Instruction("other", Target("marked"))
"""Stands in where the sentence gives no instruction: something is done to what is marked."""


def _geometry(
    photos: Views, answer: GeometryAnswer, components: Components
) -> Callable[[], Geometry | None]:
    """Asks once what is known of the unedited photos, where it can be trusted."""

    @cache
    def trusted() -> Geometry | None:
        if photos.count < 2:
            return None
        if answer is NOT_ASKED:
            return find_geometry(components.geometry_source, photos).trusted()
        return answer.trusted()

    return trusted


def _finder(
    index: int,
    inputs: Inputs,
    geometry: Callable[[], Geometry | None],
    components: Components,
) -> RegionFinder:
    """Finds things in one scene of the batch."""

    def of_scene() -> Geometry | None:
        known = geometry()
        return None if known is None else known.scene(index)

    config = components.config
    return RegionFinder(
        inputs.start.scene(index),
        selector=lambda: components.selector,
        geometry=of_scene,
        marked=inputs.marked,
        defaults=Selection(
            candidate=config.candidate,
            larger=config.larger,
            grow=config.grow,
            inverted=config.invert,
        ),
        known=inputs.things,
    )
