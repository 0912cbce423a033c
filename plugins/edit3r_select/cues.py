"""What can be seen of each mask that answers marks on one photo: the cues that the sum adds.

Each cue is a function of a `Pool` that gives one number a mask; its docstring says what it means
and in which unit. `CUES` names them in the order of the weights in `fitted.yaml`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np

BAND = 8  # how far from the outline colours are compared, inside and outside [pixels]
NOTICED = 1.15  # ratio of two areas from which one mask is larger than the other
SMALLEST = 4  # pixels under which a mask shows nothing but its size and quality

Place = tuple[float, float]  # x and y in [0, 1]
Click = tuple[Place, bool]  # and whether the thing is there
Box = tuple[float, float, float, float]  # x, y, width, height in [0, 1]


class Appearance:
    """An RGB photo, uint8 `[h, w, 3]`, with what the cues need of it; made once for all marks."""

    def __init__(self, rgb: np.ndarray) -> None:
        self.rgb = rgb
        self.size: tuple[int, int] = rgb.shape[:2]

    @cached_property
    def lab(self) -> np.ndarray:
        """OpenCV's 8-bit Lab as float32 `[h, w, 3]`."""
        return cv2.cvtColor(self.rgb, cv2.COLOR_RGB2LAB).astype(np.float32)

    @cached_property
    def edges(self) -> np.ndarray:
        """Strength of colour edges `[h, w]`; 1 is the photo's mean."""
        soft = cv2.GaussianBlur(self.lab, (0, 0), 1.0)
        across, down = (
            cv2.Sobel(soft, cv2.CV_32F, *axis) ** 2 for axis in ((1, 0), (0, 1))
        )
        strength = np.sqrt((across + down).sum(2))
        return strength / (strength.mean() + 1e-6)

    def pixel(self, place: Place) -> tuple[int, int]:
        """Row and column of a place."""
        height, width = self.size
        x, y = place
        row, column = int(y * height), int(x * width)
        return min(max(row, 0), height - 1), min(max(column, 0), width - 1)


@dataclass(frozen=True)
class Asked:
    """What was marked on one photo."""

    clicks: tuple[Click, ...] = ()  # in the order in which they were made
    stroke: tuple[Place, ...] = ()  # places along what was drawn over the thing
    box: Box | None = None  # around it
    before: np.ndarray | None = None  # bool [h, w]: the answer before the last click

    @property
    def inside(self) -> tuple[Place, ...]:
        """All places on the thing."""
        return (*self.stroke, *(place for place, wanted in self.clicks if wanted))

    @property
    def outside(self) -> tuple[Place, ...]:
        return tuple(place for place, wanted in self.clicks if not wanted)

    @property
    def kind(self) -> str:
        """Which weights hold: those of a first click, of more clicks, a stroke or a box."""
        if self.before is not None or len(self.clicks) > 1:
            return "more"
        if self.stroke:
            return "stroke"
        return "click" if self.box is None else "box"


@dataclass(frozen=True, eq=False)
class Pool:
    """Masks that may be meant, and what was asked."""

    photo: Appearance
    asked: Asked
    logits: np.ndarray  # [n, h, w] at the photo's size, > 0 inside
    quality: np.ndarray  # [n]: IoU that whoever made a mask expects, in [0, 1]
    first: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))
    """[n]: the network's single mask, which it trains for marks that leave no doubt."""

    @cached_property
    def masks(self) -> np.ndarray:
        return self.logits > 0

    @cached_property
    def areas(self) -> np.ndarray:
        """Shares of the photo."""
        return self.masks.mean((1, 2))

    @cached_property
    def overlaps(self) -> np.ndarray:
        """IoU of each mask with each other one `[n, n]`."""
        flat = self.masks.reshape(len(self.masks), -1).astype(np.float32)
        both = flat @ flat.T
        area = flat.sum(1)
        return both / np.maximum(1, area[:, None] + area[None] - both)

    @cached_property
    def depths(self) -> list[np.ndarray]:
        """Distance of each mask's pixels to what is outside, also beyond the photo [pixels]."""
        return [_depth(mask) for mask in self.masks]


def quality(pool: Pool) -> np.ndarray:
    """The IoU that the network expects of its mask, in [0, 1]."""
    return pool.quality


def log_area(pool: Pool) -> np.ndarray:
    """Logarithm of the share of the photo: people mean wholes more often than parts."""
    return np.log(pool.areas + 1e-4)


def square_of_log_area(pool: Pool) -> np.ndarray:
    """What speaks for a mask neither tiny nor as large as the photo."""
    return log_area(pool) ** 2


def stability(pool: Pool) -> np.ndarray:
    """IoU of the mask cut at logits +1 and -1, in [0, 1]."""
    loose = np.maximum(1, (pool.logits > -1).sum((1, 2)))
    return (pool.logits > 1).sum((1, 2)) / loose


def centrality(pool: Pool) -> np.ndarray:
    """How deep the places on the thing lie in the mask, as a share of its deepest point."""
    places = [pool.photo.pixel(place) for place in pool.asked.inside]
    if not places:
        return np.zeros(len(pool.masks))
    rows, columns = np.array(places).T
    return np.array([d[rows, columns].mean() / max(1, d.max()) for d in pool.depths])


def edge(pool: Pool) -> np.ndarray:
    """Logarithm of how strong colour edges are along the outline; 0 is the photo's mean."""
    values = []
    for mask in pool.masks:
        whole = mask.astype(np.uint8)
        rim = cv2.dilate(whole, np.ones((3, 3))) != cv2.erode(whole, np.ones((3, 3)))
        mean = pool.photo.edges[rim].mean() if rim.any() else 0.0
        values.append(np.log(mean + 0.1))
    return np.array(values)


def contrast(pool: Pool) -> np.ndarray:
    """Difference of the mean colours within `BAND` inside and outside of the outline [30 units of
    Lab].
    """
    values = []
    for mask, depth in zip(pool.masks, pool.depths):
        near = cv2.dilate(mask.astype(np.uint8), np.ones((2 * BAND + 1,) * 2)) > 0
        inner, outer = mask & (depth < BAND), near & ~mask
        if not (inner.any() and outer.any()):
            values.append(0.0)
            continue
        step = pool.photo.lab[inner].mean(0) - pool.photo.lab[outer].mean(0)
        values.append(float(np.linalg.norm(step)) / 30)
    return np.array(values)


def border(pool: Pool) -> np.ndarray:
    """Share of the photo's border that the mask touches: what fills it is background."""
    some = pool.masks
    sides = (some[:, 0], some[:, -1], some[:, :, 0], some[:, :, -1])
    return np.concatenate(sides, axis=1).mean(1)


def largest_piece(pool: Pool) -> np.ndarray:
    """Share of the mask that its largest connected piece has."""
    return np.array([_largest(mask) / max(1, mask.sum()) for mask in pool.masks])


def agreement(pool: Pool) -> np.ndarray:
    """Mean IoU with the other masks."""
    count = len(pool.masks)
    return (pool.overlaps.sum(1) - np.diag(pool.overlaps)) / max(1, count - 1)


def larger(pool: Pool) -> np.ndarray:
    """Share of the other masks that are larger."""
    others = pool.areas[None] > NOTICED * pool.areas[:, None]
    return others.sum(1) / max(1, len(pool.masks) - 1)


def smaller(pool: Pool) -> np.ndarray:
    """Share of the other masks that are smaller."""
    others = NOTICED * pool.areas[None] < pool.areas[:, None]
    return others.sum(1) / max(1, len(pool.masks) - 1)


def solidity(pool: Pool) -> np.ndarray:
    """Share of its convex hull that the mask fills."""
    values = []
    for mask in pool.masks:
        places = cv2.findNonZero(mask.astype(np.uint8))
        hull = 0.0 if places is None else cv2.contourArea(cv2.convexHull(places))
        values.append(min(1.5, mask.sum() / max(1.0, hull)))
    return np.array(values)


def relative_area(pool: Pool) -> np.ndarray:
    """Logarithm of the area as a share of the largest mask's."""
    return np.log(pool.areas / max(1e-6, pool.areas.max()) + 1e-3)


def first(pool: Pool) -> np.ndarray:
    """1 for the network's single mask, 0 for its several."""
    return pool.first.astype(float) if len(pool.first) else np.zeros(len(pool.masks))


def obeyed(pool: Pool) -> np.ndarray:
    """Share of the marks that the mask obeys: places on the thing inside, others outside."""
    told = [(place, True) for place in pool.asked.inside]
    told += [(place, False) for place in pool.asked.outside]
    if not told:
        return np.ones(len(pool.masks))
    rows, columns = np.array([pool.photo.pixel(place) for place, _ in told]).T
    wanted = np.array([one for _, one in told])
    return (pool.masks[:, rows, columns] == wanted).mean(1)


def kept(pool: Pool) -> np.ndarray:
    """IoU with the answer before the last click; 0 where there was none."""
    before = pool.asked.before
    if before is None:
        return np.zeros(len(pool.masks))
    both = (pool.masks & before).sum((1, 2))
    return both / np.maximum(1, (pool.masks | before).sum((1, 2)))


def middle(pool: Pool) -> np.ndarray:
    """How central the last click is in the piece that the mask changes there, in [0, 1]: people
    click in the middle of what is wrong.
    """
    before = pool.asked.before
    if before is None or not pool.asked.clicks:
        return np.zeros(len(pool.masks))
    place = pool.photo.pixel(pool.asked.clicks[-1][0])
    values = []
    for mask in pool.masks:
        labels = cv2.connectedComponents((mask ^ before).astype(np.uint8))[1]
        here = _depth(labels == labels[place]) if labels[place] else np.zeros((1, 1))
        values.append(here[place] / here.max() if labels[place] else 0.0)
    return np.array(values)


def fills_box(pool: Pool) -> np.ndarray:
    """IoU of the box around the mask with the box that was drawn; 0 where none was."""
    if pool.asked.box is None:
        return np.zeros(len(pool.masks))
    height, width = pool.photo.size
    x, y, w, h = pool.asked.box
    left, top, right, bottom = x * width, y * height, (x + w) * width, (y + h) * height
    values = []
    for mask in pool.masks:
        x, y, w, h = cv2.boundingRect(mask.astype(np.uint8))
        across = min(right, x + w) - max(left, x)
        down = min(bottom, y + h) - max(top, y)
        both = max(0.0, across) * max(0.0, down)
        values.append(both / max(1.0, w * h + (right - left) * (bottom - top) - both))
    return np.array(values)


CUES: dict[str, Callable[[Pool], np.ndarray]] = {
    one.__name__: one
    for one in (
        quality,
        log_area,
        square_of_log_area,
        stability,
        centrality,
        edge,
        contrast,
        border,
        largest_piece,
        agreement,
        larger,
        smaller,
        solidity,
        relative_area,
        first,
        obeyed,
        kept,
        middle,
        fills_box,
    )
}
"""Fifteen of a mask on one photo, then what the marks say of it."""


def table(pool: Pool, names: Sequence[str] = tuple(CUES)) -> np.ndarray:
    """Cues `[n, cue]` of every mask; a mask of a few pixels has its size and quality alone."""
    values = np.stack([CUES[name](pool) for name in names], axis=1).astype(float)
    alone = np.isin(names, ("quality", "log_area", "square_of_log_area", "obeyed"))
    empty = pool.masks.sum((1, 2)) < SMALLEST
    return np.where(empty[:, None] & ~alone, 0.0, values)


def _depth(mask: np.ndarray) -> np.ndarray:
    padded = np.pad(mask.astype(np.uint8), 1)
    return cv2.distanceTransform(padded, cv2.DIST_L2, 3)[1:-1, 1:-1]


def _largest(mask: np.ndarray) -> int:
    """Pixels of the largest connected piece."""
    stats = cv2.connectedComponentsWithStats(mask.astype(np.uint8))[2]
    return int(stats[1:, cv2.CC_STAT_AREA].max()) if len(stats) > 1 else 0
