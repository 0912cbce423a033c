"""What can be seen of each mask that answers marks on one photo: the cues that the sum adds.

Each cue is a function of a `Pool` that gives one number a mask; its docstring says what it means
and in which unit. `CUES` names them in the order of the weights in `fitted.yaml`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from edit3r.contract.interfaces import Box, Click
from edit3r.contract.interfaces.segmentation import Place

SMALLEST = 4  # pixels under which a mask shows nothing but its size and quality
OF_ANY_SIZE = ("quality", "square_of_log_area", "fourth_power_of_log_area", "obeyed")


@dataclass(frozen=True, eq=False)
class Asked:
    """What was marked on one photo."""

    clicks: tuple[Click, ...] = ()  # in the order in which they were made
    stroke: tuple[Place, ...] = ()  # places along what was drawn over the thing
    box: Box | None = None  # around it
    # logits [h, w] of the answer before the last click, > 0 inside
    before: np.ndarray | None = None
    # bool [h, w]: what other photos show of it here, or what is salient, and where that is known
    expected: np.ndarray | None = None
    known: np.ndarray | None = None

    @property
    def places(self) -> list[Click]:
        """All of a stroke and of the clicks."""
        return [*((place, True) for place in self.stroke), *self.clicks]

    @property
    def kind(self) -> str:
        """Which weights hold: those of a first click, of more clicks, a stroke, a box, of what
        other photos show, or of what stands out where nothing is marked.
        """
        if self.expected is not None:
            return "carried" if self.clicks else "unmarked"
        if self.before is not None or len(self.clicks) > 1:
            return "more"
        if self.stroke:
            return "stroke"
        return "click" if self.box is None else "box"


@dataclass(frozen=True, eq=False)
class Pool:
    """Masks that may be meant, and what was asked."""

    asked: Asked
    logits: np.ndarray  # [n, h, w], > 0 inside
    quality: np.ndarray  # [n]: IoU that whoever made a mask expects, in [0, 1]
    # False: nobody tells the quality
    is_told: bool = True

    @property
    def size(self) -> tuple[int, int]:
        height, width = self.logits.shape[1:]
        return height, width

    @cached_property
    def masks(self) -> np.ndarray:
        return self.logits > 0

    @cached_property
    def areas(self) -> np.ndarray:
        """Shares of the photo."""
        return self.masks.mean((1, 2))

    @cached_property
    def overlaps(self) -> np.ndarray:
        """IoU of each mask with each `[n, n]`."""
        flat = self.masks.reshape(len(self.masks), -1).astype(np.float32)
        both, each = flat @ flat.T, flat.sum(1)
        return both / np.maximum(1, each[:, None] + each - both)

    def holds(self, clicks: Sequence[Click]) -> np.ndarray:
        """Whether each mask holds the place of each click `[n, click]`."""
        rows, columns = np.array([pixel(place, self.size) for place, _ in clicks]).T
        return self.masks[:, rows, columns]


def pixel(place: Place, size: tuple[int, int]) -> tuple[int, int]:
    """Row and column of a place on a picture of height and width `size`."""
    (height, width), (x, y) = size, place
    row, column = int(y * height), int(x * width)
    return min(max(row, 0), height - 1), min(max(column, 0), width - 1)


def quality(pool: Pool) -> np.ndarray:
    """The IoU that the network expects of its mask, in [0, 1]."""
    return pool.quality


def square_of_log_area(pool: Pool) -> np.ndarray:
    """What speaks for a mask neither tiny nor as large as the photo: the square of the logarithm of
    its share of that.
    """
    return np.log(pool.areas + 1e-4) ** 2


def fourth_power_of_log_area(pool: Pool) -> np.ndarray:
    """The square of `square_of_log_area`, with which what speaks for a size is a curve."""
    return square_of_log_area(pool) ** 2


def stability(pool: Pool) -> np.ndarray:
    """IoU of the mask cut at logits +1 and -1, in [0, 1]."""
    loose = np.maximum(1, (pool.logits > -1).sum((1, 2)))
    return (pool.logits > 1).sum((1, 2)) / loose


def centrality(pool: Pool) -> np.ndarray:
    """How deep the places on the thing lie in the mask, as a share of its deepest point."""
    inside = [place for place, wanted in pool.asked.places if wanted]
    if not inside:
        return np.zeros(len(pool.masks))
    rows, columns = np.array([pixel(place, pool.size) for place in inside]).T
    depths = [_depth(mask) for mask in pool.masks]
    return np.array([d[rows, columns].mean() / max(1, d.max()) for d in depths])


def square_of_centrality(pool: Pool) -> np.ndarray:
    """People click near the middle, or anywhere: that says less of a click further out."""
    return centrality(pool) ** 2


def border(pool: Pool) -> np.ndarray:
    """Share of the photo's border that the mask touches: what fills it is background."""
    some = pool.masks
    sides = (some[:, 0], some[:, -1], some[:, :, 0], some[:, :, -1])
    return np.concatenate(sides, axis=1).mean(1)


def largest_piece(pool: Pool) -> np.ndarray:
    """Share of the mask that its largest connected piece has."""
    found = [
        cv2.connectedComponentsWithStats(mask.astype(np.uint8))[2]
        for mask in pool.masks
    ]
    largest = [stats[1:, cv2.CC_STAT_AREA].max(initial=0) for stats in found]
    return np.array(largest) / np.maximum(1, pool.masks.sum((1, 2)))


def obeyed(pool: Pool) -> np.ndarray:
    """Share of the marks that the mask obeys: places on the thing inside, others outside."""
    told = pool.asked.places
    if not told:
        return np.ones(len(pool.masks))
    return (pool.holds(told) == [wanted for _, wanted in told]).mean(1)


def agreement(pool: Pool) -> np.ndarray:
    """Mean IoU with the other masks that answer a further click, which all know the answer before;
    0 for a first one.
    """
    count = len(pool.masks)
    if pool.asked.before is None or count < 2:
        return np.zeros(count)
    return (pool.overlaps.sum(1) - pool.masks.any((1, 2))) / (count - 1)


def middle(pool: Pool) -> np.ndarray:
    """How central the last click is in the piece that the mask changes there, in [0, 1]: people
    click in the middle of what is wrong.
    """
    before = pool.asked.before
    if before is None or not pool.asked.clicks:
        return np.zeros(len(pool.masks))
    place = pixel(pool.asked.clicks[-1][0], pool.size)
    values = []
    for mask in pool.masks:
        changed = (mask ^ (before > 0)).astype(np.uint8)
        labels = cv2.connectedComponents(changed)[1]
        here = _depth(labels == labels[place]) if labels[place] else np.zeros((1, 1))
        values.append(here[place] / here.max() if labels[place] else 0.0)
    return np.array(values)


def expected(pool: Pool) -> np.ndarray:
    """IoU with what other photos show, where they show anything; 0 where nobody asked them."""
    there, known = pool.asked.expected, pool.asked.known
    if there is None:
        return np.zeros(len(pool.masks))
    either = ((pool.masks & known) | there).sum((1, 2))
    return (pool.masks & there).sum((1, 2)) / np.maximum(1, either)


CUES: dict[str, Callable[[Pool], np.ndarray]] = {
    one.__name__: one
    for one in (
        quality,
        square_of_log_area,
        fourth_power_of_log_area,
        stability,
        centrality,
        square_of_centrality,
        border,
        largest_piece,
        obeyed,
        agreement,
        middle,
        expected,
    )
}
"""Eight of a mask on one photo, then what the marks say of it, then what other photos do."""


def table(pool: Pool, names: Sequence[str] = tuple(CUES)) -> np.ndarray:
    """Cues `[n, cue]` of every mask; a mask of a few pixels has its size and quality alone."""
    values = np.stack([CUES[name](pool) for name in names], axis=1).astype(float)
    empty = pool.masks.sum((1, 2)) < SMALLEST
    return np.where(empty[:, None] & ~np.isin(names, OF_ANY_SIZE), 0.0, values)


def _depth(mask: np.ndarray) -> np.ndarray:
    """Distance of a mask's pixels to what is outside, also beyond the photo [pixels]."""
    padded = np.pad(mask.astype(np.uint8), 1)
    return cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]
