"""What clicks at other places of a thing would mean: of a fox with a rose of the wall most say that
something else was meant.
"""

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Proposal
from edit3r.running.selecting.select import Selected

PLACES = 8  # that are asked for, at most
INNER = (
    0.25  # of the depth of a thing's innermost place, from which a place is well inside
)
SAME_THING = 0.7  # overlap from which the surest answer to a click is the thing
KNOWN, KNOWN_AT = 0.75, 0.5  # overlap and share of places from which a network knows it

Ask = Callable[
    [Float[Tensor, "3 height width"], tuple[float, float]], Sequence[Proposal]
]


def meant_elsewhere(
    images: Float[Tensor, "view 3 height width"],
    selected: Sequence[Selected],
    ask: Ask,
) -> bool | None:
    """Whether a click alone, at one of several places within a clicked thing, means it most surely.

    None where nothing was clicked on, and for what the network knows by no answer: a shape that was
    drawn, grown or joined.
    """
    found = []
    for one in selected:
        taken = [reading for reading in one.readings if reading.number == one.taken]
        if taken and "marked" in one.how:
            photo = images[taken[0].view]
            found.append(_is_meant(photo, taken[0].mask > 0.5, ask))
    known = [meant for meant in found if meant is not None]
    return all(known) if known else None


def _is_meant(
    photo: Float[Tensor, "3 height width"],
    thing: Bool[Tensor, "height width"],
    ask: Ask,
) -> bool | None:
    height, width = thing.shape
    known = []
    for row, column in _places(thing.numpy(force=True)):
        answers = ask(photo, ((column + 0.5) / width, (row + 0.5) / height))
        if not answers:
            return None
        overlaps = [_overlap(answer.soft_mask > 0.5, thing) for answer in answers]
        if overlaps[0] > SAME_THING:
            return True
        known.append(max(overlaps) > KNOWN)
    return False if known and np.mean(known) >= KNOWN_AT else None


def _places(thing: Bool[np.ndarray, "height width"]) -> list[tuple[int, int]]:
    """Rows and columns well inside, far from each other; the innermost first."""
    padded = np.pad(thing.astype(np.uint8), 1)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
    inner = np.argwhere(thing & (depth >= INNER * depth.max()))
    if not len(inner):
        return []
    apart = depth[tuple(inner.T)].astype(float)
    chosen: list[tuple[int, int]] = []
    for _ in range(min(PLACES, len(inner))):
        place = inner[apart.argmax()]
        beside = np.linalg.norm(inner - place, axis=1)
        apart = beside if not chosen else np.minimum(apart, beside)
        chosen.append((int(place[0]), int(place[1])))
    return chosen


def _overlap(one: Bool[Tensor, "height width"], other: Tensor) -> float:
    return float((one & other).sum() / (one | other).sum().clamp(min=1))
