"""The selector `by-segmenter`: marks and words on some photos, and what they mean on all.

On each photo a sum of cues says which mask is meant (`ranking.py`). A photo without marks is told
by the scene's geometry what others show, else by the segmenter, if it follows objects.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    ASK,
    BACKGROUND,
    SURE,
    Box,
    Candidate,
    Geometry,
    Proposal,
    Segmenter,
    Selected,
    Selection,
    Selector,
)
from edit3r.contract.reporting import note, say, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit import asking
from edit3r_select.answering import answered
from edit3r_select.carrying import agreed, carried
from edit3r_select.marks import Marks, marks_on
from edit3r_select.naming import (
    MAX_CANDIDATES,
    SAME_THING,
    looked_up,
    named_again,
    numbered,
    taken_of,
)
from edit3r_select.obeying import Point, obeyed, points_of, seen_elsewhere
from edit3r_select.photos import Found, Mask, Named, OnPhoto, Photos, clean, overlap
from edit3r_select.ranking import SAME

INSIDE = 0.95  # share of a part that lies inside of its whole, at least
CLICKED_SURE = 0.25  # confidence of words that a click lies on, from which they say how far it goes


class SegmenterSelector(Selector):
    """What a segmenter answers for the marks on a photo, carried to all photos."""

    class Settings(edit3r.Settings):
        segmenter: PartChoice = PartChoice(name="auto")
        """answers marks and words on one photo"""

    settings: Settings

    def __init__(self, settings: Settings, segmenter: Segmenter) -> None:
        self.settings, self.segmenter = settings, segmenter

    def select(
        self, views: Views, selection: Selection, geometry: Geometry | None = None
    ) -> Selected:
        return select_masks(
            views.images[0], selection, self.segmenter, geometry, views.intrinsics
        )


def select_masks(
    images: Float[Tensor, "view 3 height width"],
    selection: Selection,
    segmenter: Segmenter,
    geometry: Geometry | None = None,
    intrinsics: Float[Tensor, "1 view 3 3"] | None = None,
) -> Selected:
    """Find the chosen object on every view.

    `geometry` (batch 1) and `intrinsics` are those of the same views; without them only a
    segmenter that follows objects carries masks. What stands out is taken for words that nobody
    knows or finds, as a question. Raises InputError for marks outside the photos.
    """
    _check(selection, len(images))
    if geometry is not None and geometry.intrinsics is not None:
        intrinsics = geometry.intrinsics
    photos = Photos(images, segmenter, geometry, intrinsics)
    named = Named() if selection.says_where else looked_up(photos, selection)
    # a thing is found again on other photos, all else is not
    all_else = selection.words == BACKGROUND and not selection.says_where
    found = {
        view: replace(one, mask=1 - one.mask) if all_else else one
        for view, one in named.found.items()
    }
    sure, options, fits = [named.confidence], named.candidates, None
    for view in selection.views:
        found[view], told = _marked(photos, selection, found, view)
        # a photo that was marked before says which
        options = options or told.candidates
        fits = told.fits if fits is None else fits
        sure.append(told.confidence)
    found |= carried(photos, found, set(range(len(images))) - set(found))
    if not all_else:
        found = {
            view: named_again(photos, selection, named, view, one)
            for view, one in found.items()
        }
    if not named.each:
        found = agreed(photos, found, set(selection.added))
    masks = [
        _final(photos, selection, found[view].mask, view) for view in sorted(found)
    ]
    how = tuple(found[view].how for view in sorted(found))
    note(
        "selection",
        {
            "points": selection.positive,
            "not": selection.negative,
            "boxes": selection.boxes,
            "regions": selection.regions,
            "how": how,
        },
    )
    grow = -selection.grow if all_else else selection.grow
    final, warnings = grown(torch.stack(masks)[:, None], grow), [*named.warnings]
    warnings += _told(selection, len(options), how, fits)
    if selection.inverted != all_else:
        final = 1 - final
    for text in warnings:
        warn(text)
    return Selected(
        final,
        how,
        tuple(warnings),
        min((one for one in sure if one is not None), default=None),
        options,
        selection.candidate,
        fits=fits,
        knows_words=named.knows_words,
    )


def grown(
    masks: Float[Tensor, "view 1 height width"], pixels: float
) -> Float[Tensor, "view 1 height width"]:
    """Soft masks with their outline moved outwards, inwards where `pixels` is negative; the soft
    edge moves along.
    """
    if not pixels:
        return masks
    reach = int(np.ceil(abs(pixels)))
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = (np.hypot(rows, columns) <= abs(pixels) + 0.25).astype(np.uint8)
    move = cv2.dilate if pixels > 0 else cv2.erode
    moved = [move(mask.numpy(force=True), disc) for mask in masks[:, 0]]
    return torch.from_numpy(np.stack(moved))[:, None].to(masks)


def filled(box: Box, size: Sequence[int]) -> Mask:
    """A mask of 1 in a box [shares of the sides], 0 elsewhere."""
    height, width = size
    left, top, across, down = box
    mask = torch.zeros(height, width)
    rows = slice(round(top * height), round((top + down) * height))
    columns = slice(round(left * width), round((left + across) * width))
    mask[rows, columns] = 1
    return mask


def _check(selection: Selection, count: int) -> None:
    """Marks lie on views that exist, and masks are made of numbers."""
    for view, mask in selection.masks.items():
        if not torch.isfinite(mask).all():
            raise InputError(
                f"the mask of photo {view + 1} has values that are no numbers."
            )
    outside = [view for view in selection.views if not 0 <= view < count]
    if outside:
        raise InputError(
            f"photo {outside[0] + 1} is marked, but there are {count} photos."
        )


@dataclass(frozen=True)
class Described:
    """What clicks, strokes and a box mean on one photo."""

    mask: Mask
    candidates: tuple[Candidate, ...] = ()  # what else they may mean
    confidence: float | None = None  # in [0, 1]; None: nobody can tell
    fits: bool | None = None  # as that of `Selected`


def _marked(
    photos: Photos, selection: Selection, found: Found, view: int
) -> tuple[OnPhoto, Described]:
    """What is selected on a photo that carries marks, and what clicks, strokes and box said of it;
    what other photos showed so far is where it is expected.
    """
    image, nothing = photos.images[view], torch.zeros_like(photos.images[view, 0])
    if view in selection.masks:
        given = clean(selection.masks[view], image)
        return OnPhoto(_painted(selection, given, view), "given"), Described(given)
    before = found.get(view)
    # what words found, or what stands out, is that without what is said to lie beside it
    how = "marked" if before is None else before.how
    if before is None and found:
        before = carried(photos, found, {view})[view]
    prior = None
    if before is not None and view not in selection.boxes and before.inside.any():
        prior = before.mask
    marks = replace(marks_on(selection, view), prior=prior, larger=selection.larger)
    told = Described(nothing if prior is None else prior)
    if marks.says_where or (marks.negative and prior is not None):
        told = _described(photos, selection, view, marks)
    elif prior is None and view in {on for on, _ in selection.regions}:
        how = "region"
    elif prior is None and view not in selection.added:
        raise InputError(
            f"photo {view + 1} is only told what is not the object; {ASK} on it."
        )
    painted = _painted(selection, clean(told.mask, image), view)
    return OnPhoto(painted, how), told


def _described(
    photos: Photos, selection: Selection, view: int, marks: Marks
) -> Described:
    """The object that marks describe, what else they may mean, and how sure it is.

    A click says where, and words say how far: a click on a wheel beside the word "bike" means the
    bike. What they name is a candidate too, and comes before a larger one: a fox before the fox
    with its plaque.
    """
    image = photos.images[view]
    told = answered(photos.segmenter, image, marks)
    if marks.larger or marks.prior is not None:
        return Described(told.mask, (), told.confidence)
    pairs = [
        (one.soft_mask, one.confidence) for one in told.candidates[:MAX_CANDIDATES]
    ]
    by_name, is_elsewhere = _named_at(photos, selection, view, marks)
    if by_name is None:
        options = numbered(view, pairs)
        mask = taken_of(options, selection.candidate).mask
        return Described(
            mask, options, told.confidence, False if is_elsewhere else None
        )
    named = by_name.soft_mask
    options = numbered(view, _with_named(pairs, named))
    found = taken_of(options, selection.candidate).mask
    if overlap(found, named) >= SAME_THING or selection.candidate > 1:
        is_own = overlap(found, told.mask) >= SAME
        sure = told.confidence if is_own else by_name.confidence
        fits = overlap(found, named) >= SAME_THING or None
        return Described(found, options, sure, fits)
    say("selection.clicked", f"what is clicked on is {selection.words}")
    height, width = named.shape
    points = points_of(marks)
    if all(
        bool(named[point.pixel((height, width))] > 0.5) == point.wanted
        for point in points
    ):
        return Described(named, (), by_name.confidence, True)
    corrected = answered(photos.segmenter, image, replace(marks, prior=named))
    return Described(corrected.mask, (), corrected.confidence, True)


def _named_at(
    photos: Photos, selection: Selection, view: int, marks: Marks
) -> tuple[Proposal | None, bool]:
    """What the words name where the first click lies, and whether they surely name what lies
    elsewhere; neither without words, or where a box says more.
    """
    if not selection.words or not marks.positive or marks.box is not None:
        return None, False
    image, place = photos.images[view], Point(marks.positive[0], True)
    there = asking.words(photos.segmenter, image, selection.words) or ()
    for one in there:
        clicked = one.soft_mask[place.pixel(one.soft_mask.shape)] > 0.5
        if clicked and one.confidence >= CLICKED_SURE:
            return one, False
    return None, any(one.confidence >= SURE for one in there)


def _with_named(
    options: list[tuple[Mask, float]], named: Mask
) -> list[tuple[Mask, float]]:
    """Candidates of a click, and what words name there as one more, as likely as the first; before
    the first where it is a part of that.
    """
    alike = [one for one in options if overlap(named, one[0]) >= SAME]
    if not alike:
        return [*options, (named, options[0][1])]
    part, whole = alike[0][0] > 0.5, options[0][0] > 0.5
    if (part & whole).sum() < INSIDE * part.sum():
        return options
    return [alike[0], *(one for one in options if one is not alike[0])]


def _painted(selection: Selection, mask: Mask, view: int) -> Mask:
    """Brush, exact boxes and eraser are taken as they are."""
    for box in (box for on, box in selection.regions if on == view):
        mask = torch.maximum(mask, filled(box, mask.shape).to(mask))
    if view in selection.added:
        mask = torch.maximum(mask, selection.added[view].to(mask))
    if view in selection.removed:
        mask = mask * (1 - selection.removed[view].to(mask))
    return mask


def _final(photos: Photos, selection: Selection, mask: Mask, view: int) -> Mask:
    """The mask of a photo that obeys all points that it shows, its own last, and what was painted
    on it.
    """
    points: list[Point] = []
    for source in selection.views:
        marks = points_of(marks_on(selection, source))
        if source != view:
            points += seen_elsewhere(marks, photos, source, view)
    points += points_of(marks_on(selection, view))
    held = obeyed(photos.images[view], mask, points, photos.segmenter)
    return _painted(selection, held, view)


def _told(
    selection: Selection, count: int, how: Sequence[str], fits: bool | None
) -> list[str]:
    """What went otherwise than was asked, where there are `count` candidates."""
    told = []
    if fits is False:
        told.append(
            f"{selection.words!r} was found elsewhere, not where it is marked; what is marked is "
            "taken."
        )
    if count and selection.candidate > count:
        told.append(
            f"--candidate {selection.candidate}: there are {count}; the last one is taken."
        )
    for view, one in enumerate(how):
        if one == "not found":
            told.append(
                f"the object was not found on photo {view + 1}, which is edited as if it were not "
                "there; if it is there, click on it, or give its mask (--mask)."
            )
    return told
