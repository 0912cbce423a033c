"""Things of a scene that nobody marked: `edit3r objects RUN find`.

Boxes of a detector and a grid of clicks give masks on one photo. The scene's depth says where each
lies on another photo, and a click there says whether that photo shows the same thing. Of those
that overlap, named things come first, then the largest that both photos show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r import default_registry
from edit3r.contract.interfaces import Detection, Detector, Selection, Selector
from edit3r.contract.types import Cameras, Views
from edit3r.kit import asking
from edit3r.kit.compute.outlines import box_around, overlap
from edit3r.kit.geometry.warping import shared_surface, warp
from edit3r.running import usual_selector

# The numbers of this block: no figures kept.
MOST = 12  # things of a scene
GRID = 5  # clicks along each side of a photo
CONFIDENCE = 0.7  # least confidence that a click's answer is what is meant
SMALLEST, LARGEST = 0.003, 0.4  # shares of a photo
ON_RIM = 0.2  # share of its box's sides on the photo's rim from which it is floor, wall or sky
# relative difference of depth within which two photos show one surface
SAME_PLACE = 0.1
SEEN = 0.3  # share of a mask that another photo must show to say anything of it
SAME = 0.5  # overlap from which two masks are one thing
APART = 0.2  # share of the smaller of two masks that they may have in common
LIKELY = 0.35  # score of a detector's box from which it is looked into
# scores that the better and the other photo give a word that is taken
NAMED, AGAIN = 0.4, 0.25
REACH = 4  # how far beside an outline depths are compared [pixels]
STEP = 0.05  # relative difference of depth from which one lies before the other
MOSTLY = 0.7  # share of its outline that must lie behind for a gap

Mask = Bool[np.ndarray, "height width"]


@dataclass(frozen=True)
class Finders:
    """What looks at photos."""

    selector: Selector
    detector: Detector | None  # None: things get numbers for names


@dataclass(frozen=True)
class FoundThing:
    """A thing on each photo; the masks of photos where it was not looked for are empty."""

    name: str  # "": no word fits
    masks: Float[Tensor, "view height width"]
    confirmed: bool  # whether a second photo shows the same thing there


@dataclass(frozen=True)
class _Seen:
    """What one photo shows of a thing."""

    mask: Mask
    confidence: float  # in [0, 1]: that it is what was clicked on
    name: str = ""  # of a detector's box
    score: float = 0.0  # of that


def usual_tools() -> Finders:
    """A SAM and NanoDet where their weights are at hand, else what needs none."""
    registry = default_registry()
    names = registry.ready("detector", "coco", "nanodet")
    return Finders(
        usual_selector(), registry.build("detector", "coco") if names else None
    )


def find_things(
    images: Float[Tensor, "view 3 height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
    tools: Finders,
) -> list[FoundThing]:
    """At most `MOST` things that do not overlap; those that two photos show come first.

    Looked at are the first photo and the one in the middle of the others; depths and cameras
    (batch 1) are the scene's own on all photos.
    """
    other = len(images) // 2
    photos = [
        Views(images[None, [view]], cameras.intrinsics[:, [view]])
        for view in range(len(images))
    ]
    depth = depths[0].numpy(force=True)
    seen = _seen_on(photos[0], tools)
    found = [one for one in seen if one.name or not _behind(one.mask, depth)]
    things = []
    boxes = _boxes(photos[other], tools) if other else ()
    for one in _apart(found)[:MOST]:
        masks = torch.zeros_like(depths)
        masks[0] = torch.from_numpy(one.mask).to(masks)
        again = None
        if other:
            pair = [0, other]
            expected, known = _expected(one.mask, depths[pair], cameras.select(pair))
            again = _seen_again(photos[other], expected, known, tools.selector)
            there = expected if again is None else again
            masks[other] = torch.from_numpy(there)
            one = _named_by_both(one, there, boxes)
        things.append(FoundThing(one.name, masks, again is not None))
    return sorted(things, key=lambda thing: not thing.confirmed)


def _seen_on(photo: Views, tools: Finders) -> list[_Seen]:
    """Boxes with a name, then what a grid of clicks shows beside them."""
    height, width = photo.image_size
    sightings: list[_Seen] = []
    for one in _boxes(photo, tools):
        if one.score >= LIKELY:
            x, y, across, down = one.box
            box = (x / width, y / height, across / width, down / height)
            asked = Selection(boxes={0: box})
            _add(sightings, *_selected(photo, asked, tools.selector), one)
    for place in _grid():
        column, row = int(place[0] * width), int(place[1] * height)
        if not any(one.mask[row, column] for one in sightings):
            asked = Selection(positive=((0, *place),))
            _add(sightings, *_selected(photo, asked, tools.selector))
    return sightings


def _selected(photo: Views, asked: Selection, selector: Selector) -> tuple[Mask, float]:
    """What is selected on one photo, and how likely that is meant."""
    selected = asking.select(selector, photo, asked, None)
    mask = selected.masks[0, 0].numpy(force=True) > 0.5
    return mask, selected.candidates[0].score if selected.candidates else 1.0


def _boxes(photo: Views, tools: Finders) -> tuple[Detection, ...]:
    if tools.detector is None:
        return ()
    return asking.detect(tools.detector, photo.images[0, 0], "")


def _named_by_both(seen: _Seen, there: Mask, boxes: Sequence[Detection]) -> _Seen:
    """The same without a name that another photo does not confirm: a stone bear seems a sheep."""
    box = cv2.boundingRect(there.astype(np.uint8))
    again = [
        one.score
        for one in boxes
        if one.label == seen.name and _box_overlap(one.box, box) >= SAME
    ]
    other = max(again, default=0.0)
    sure = min(seen.score, other) >= AGAIN and max(seen.score, other) >= NAMED
    return seen if sure else replace(seen, name="")


def _box_overlap(one: Sequence[float], other: Sequence[float]) -> float:
    """Intersection over union of two boxes (x, y, width, height)."""
    ends = [min(one[i] + one[i + 2], other[i] + other[i + 2]) for i in (0, 1)]
    across, down = (max(0.0, ends[i] - max(one[i], other[i])) for i in (0, 1))
    shared = across * down
    return shared / max(one[2] * one[3] + other[2] * other[3] - shared, 1e-9)


def _grid() -> list[tuple[float, float]]:
    """Clicks from the middle of the photo outwards."""
    steps = (np.arange(GRID) + 0.5) / GRID
    places = [(float(x), float(y)) for y in steps for x in steps]
    return sorted(places, key=lambda place: max(abs(p - 0.5) for p in place))


def _add(
    sightings: list[_Seen],
    mask: Mask,
    confidence: float,
    detection: Detection | None = None,
) -> None:
    """Keep what looks like a thing and is not there yet."""
    fits = SMALLEST <= mask.mean() <= LARGEST and _on_rim(mask) < ON_RIM
    if not fits or (detection is None and confidence < CONFIDENCE):
        return
    if all(overlap(mask, one.mask) < SAME for one in sightings):
        named = () if detection is None else (detection.label, detection.score)
        sightings.append(_Seen(mask, confidence, *named))


def _on_rim(mask: Mask) -> float:
    """How much of the photo's rim the mask holds, as a share of its box's sides."""
    rim = sum(int(side.sum()) for side in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    _, _, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return rim / (2 * (width + height))


def _expected(
    mask: Mask, depths: Float[Tensor, "2 height width"], pair: Cameras
) -> tuple[Mask, Mask]:
    """Where the second photo shows what the first one's mask covers; where it can tell."""
    swapped = [1, 0]
    grid, same = shared_surface(
        depths[swapped], pair.intrinsics[0, swapped], pair.c2w[0, swapped], SAME_PLACE
    )
    moved = warp(torch.from_numpy(mask)[None].to(depths), grid, padding="zeros")[0]
    known = same.numpy(force=True)
    return (moved.numpy(force=True) > 0.5) & known, known


def _seen_again(
    photo: Views, expected: Mask, known: Mask, selector: Selector
) -> Mask | None:
    """The thing at the innermost expected place; None where it is another one."""
    if expected.mean() < SMALLEST * SEEN:
        return None
    inside = cv2.distanceTransform(expected.astype(np.uint8), cv2.DIST_L2, 3)
    row, column = np.unravel_index(inside.argmax(), inside.shape)
    height, width = expected.shape
    place = ((column + 0.5) / width, (row + 0.5) / height)
    marks = Selection(positive=((0, *place),), boxes={0: box_around(expected)})
    mask, _ = _selected(photo, marks, selector)
    return mask if overlap(mask & known, expected) >= SAME else None


def _behind(mask: Mask, depth: Float[np.ndarray, "height width"]) -> bool:
    """Whether it lies behind what surrounds it: a gap that is looked through."""
    disc = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    inside = np.where(mask, depth, 0)
    rim = mask & (cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) == 0)
    outside = np.where(mask | (depth <= 0), np.inf, depth).astype(np.float32)
    nearest = cv2.erode(outside, disc)
    return bool((nearest < (1 - STEP) * cv2.dilate(inside, disc))[rim].mean() > MOSTLY)


def _apart(sightings: Sequence[_Seen]) -> list[_Seen]:
    """Those that do not overlap: named ones before others, large and clear ones first."""
    kept: list[_Seen] = []
    for one in sorted(sightings, key=_worth, reverse=True):
        if all(_common(one.mask, other.mask) < APART for other in kept):
            kept.append(one)
    return kept


def _worth(seen: _Seen) -> tuple[bool, float]:
    return bool(seen.name), seen.confidence * float(seen.mask.mean()) ** 0.25


def _common(one: Mask, other: Mask) -> float:
    """Share of the smaller of two masks that the larger one covers."""
    return float((one & other).sum() / max(min(one.sum(), other.sum()), 1))
