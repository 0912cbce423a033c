"""The call from Python that selects a thing on all photos: `edit3r.select`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    Candidate,
    Matcher,
    Segmenter,
    Selected,
    Selection,
    Selector,
)
from edit3r.contract.settings import PartChoice
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.types import Views
from edit3r.kit import asking
from edit3r.kit.cache import Cache, using
from edit3r.kit.photos.images import load_photos
from edit3r.kit.photos.temporary import Pictures
from edit3r.loading.registry import default_registry
from edit3r.running.config import DEFAULTS
from edit3r.running.geometry import default_matcher, geometry_of

_built: WeakKeyDictionary[Cache, tuple[str, Segmenter]] = WeakKeyDictionary()
"""The segmenter that answered last by a cache: loading its networks takes longer than a click."""


@dataclass(frozen=True, eq=False)
class Selecting:
    """What was selected on photos; of a batch, candidates and confidences are the first scene's."""

    views: Views  # the photos
    masks: Float[Tensor, "batch view height width"]  # soft, in [0, 1]
    candidates: tuple[Candidate, ...]  # what may be meant, smallest first
    # in [0, 1]: that it is what was meant; None: marked exactly, or nobody can tell
    confidence: float | None
    is_sure: bool
    why: str  # how it was found on each photo, in one sentence
    how: tuple[str, ...]  # the same as one word for each photo
    warnings: tuple[str, ...] = ()


@in_usual_torch
def select(
    photos: Views | Pictures,
    selection: Selection,
    *,
    segmenter: str | Mapping[str, Any] | PartChoice | Segmenter | None = None,
    cache: Cache | None = None,
) -> Selecting:
    """Find what a selection means on all photos, as a run with default settings does.

    Geometry of the photos and answers of networks are kept in `cache`, so that a further click, or
    a run with the same cache, need not find them again.

    Raises:
        InputError: For marks outside the photos.
    """
    cache = cache or Cache()
    matcher = default_matcher(default_registry())
    with using(cache), torch.no_grad():
        selector = usual_selector(_ready(segmenter, cache))
        return select_with(photos, selection, selector, matcher)


def select_with(
    photos: Views | Pictures,
    selection: Selection,
    selector: Selector,
    matcher: Matcher | None,
) -> Selecting:
    """The same with built parts, by the cache of the current run."""
    views = photos if isinstance(photos, Views) else load_photos(photos).views
    _check_masks(views, selection)
    geometry = None if matcher is None else geometry_of(matcher, views)
    scenes = [
        asking.select(
            selector,
            views.scene(index),
            selection,
            None if geometry is None else geometry.scene(index),
        )
        for index in range(len(views.images))
    ]
    first = scenes[0]
    return Selecting(
        views,
        torch.stack([one.masks[:, 0] for one in scenes]),
        tuple(sorted(first.candidates, key=lambda one: float((one.mask > 0.5).sum()))),
        first.confidence,
        first.is_sure,
        _why(views, first),
        first.how,
        first.warnings,
    )


def _check_masks(views: Views, selection: Selection) -> None:
    """Raise InputError for masks of another size than the photos."""
    size = list(views.image_size)
    for masks in (selection.masks, selection.added, selection.removed):
        for view, mask in masks.items():
            if list(mask.shape) != size:
                raise InputError(
                    f"the mask of photo {view + 1} is {list(mask.shape)}; expected the photos' "
                    f"size {size}."
                )


def usual_selector(segmenter: Segmenter | None = None) -> Selector:
    """The selector that a run takes unasked, with a segmenter that is built, or its own."""
    choice = PartChoice(name=DEFAULTS["selector"])
    parts = None if segmenter is None else {"segmenter": segmenter}
    return default_registry().build_choice("selector", choice, parts)


def _why(views: Views, found: Selected) -> str:
    names = views.names or tuple(str(view + 1) for view in range(views.count))
    listed = ", ".join(f"{name}: {how}" for name, how in zip(names, found.how))
    if found.confidence is None:
        return listed
    return f"{listed}; confidence {found.confidence:.0%}"


def _ready(choice: Any, cache: Cache) -> Segmenter:
    if isinstance(choice, Segmenter):
        return choice
    if isinstance(choice, Mapping) and "name" not in choice:
        raise InputError(f"segmenter: {dict(choice)} has no name; give one: name=...")
    if not isinstance(choice, str | Mapping | PartChoice | None):
        raise InputError(
            f"segmenter: got {type(choice).__name__}, expected a name, a name with settings, or a "
            "Segmenter."
        )
    if isinstance(choice, Mapping):
        settings = {key: value for key, value in choice.items() if key != "name"}
        choice = PartChoice(name=choice["name"], settings=settings)
    if not isinstance(choice, PartChoice):
        choice = PartChoice(name=choice or DEFAULTS["segmenter"])
    registry = default_registry()
    # As settings, since what "best" means changes when weights are fetched.
    checked = registry.check("segmenter", choice)
    key = f"{choice.name} {checked.model_dump_json()}"
    if _built.get(cache, ("",))[0] != key:
        _built[cache] = key, registry.build_choice("segmenter", choice)
    return _built[cache][1]
