"""Follow objects from the first view through the others, by dense flow where views are close, else by features.

View by view, from the last earlier view that showed the object: dense inverse-search flow with a forward-backward
check carries the mask; where flow breaks down, SIFT matches on the object give an affine map to start it from. The
outline is then snapped to the colours of the new view. An object whose match is too thin or looks different is
reported lost.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from edit3r_segmenters.classical.segmenter_masks import overlap, snapped, softened
from edit3r_segmenters.classical.tracking_features import affine_between
from edit3r_segmenters.classical.tracking_flow import Flow, carry, flow_between

GOOD_SCORE = 0.8  # consistent share times likeness above which nothing else is tried
MIN_CONSISTENT = 0.35  # share under which flow says nothing
UNCHECKED = 0.3  # what counts as consistent share where only features say where the object is
MIN_LIKENESS = 0.5  # overlap of colour histograms under which it is not the same object
MAX_GROWTH = 2.5  # change of area, either way, between two views beyond which an object counts as lost
MAX_TOTAL_GROWTH = 6.0  # the same between the first view and any other
SNAP_BAND = 0.04  # how far the outline may move when it is snapped [square roots of the area]


@dataclass(frozen=True)
class Followed:
    """Objects in all views."""

    soft_masks: np.ndarray  # float32 [V, R, H, W] in [0, 1], zero where lost
    present: np.ndarray  # bool [V, R]


@dataclass(frozen=True)
class _View:
    """A view at tracking size."""

    pixels: np.ndarray  # uint8 RGB [h, w, 3]
    grey: np.ndarray  # uint8 [h, w]


def follow(pictures: list[np.ndarray], masks: np.ndarray, size: int) -> Followed:
    """Follow `masks` `[R, H, W]` on the first of `pictures` (float RGB `[H, W, 3]`, one size) through all of them."""
    views = [_view(picture, size) for picture in pictures]
    height, width = views[0].grey.shape
    first = [cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA) > 0.5 for mask in masks.astype(np.float32)]
    found: list[list[np.ndarray | None]] = [[mask if mask.any() else None for mask in first]]
    for index in range(1, len(views)):
        tracker = _Step(views, found, index)
        found.append([tracker.find(number) for number in range(len(masks))])
    soft = np.zeros((len(views), len(masks), *pictures[0].shape[:2]), np.float32)
    for index, row in enumerate(found):
        for number, mask in enumerate(row):
            if mask is not None:
                soft[index, number] = masks[number] if index == 0 else softened(pictures[index], mask)
    present = np.array([[mask is not None for mask in row] for row in found], dtype=bool)
    return Followed(soft, present.reshape(len(views), len(masks)))


@dataclass(frozen=True)
class _Guess:
    """Where an object may be."""

    mask: np.ndarray  # bool [h, w]
    consistent: float  # share of it that flow carries there and back, in [0, 1]


class _Step:
    """The search in one view; flow to each earlier view is computed once for all objects."""

    def __init__(self, views: list[_View], found: list[list[np.ndarray | None]], index: int) -> None:
        self.views, self.found, self.index = views, found, index
        self.flows: dict[int, Flow] = {}

    def find(self, number: int) -> np.ndarray | None:
        """Mask of object `number` in this view, None when it is lost."""
        if self.found[0][number] is None:
            return None
        best, best_score = None, 0.0
        for way in (self._by_flow, self._by_features):
            for source in self._sources(number):
                guess = way(source, number)
                score = self._score(guess, source, number) if guess is not None else 0.0
                if score > best_score:
                    best, best_score = guess.mask, score
            if best_score >= GOOD_SCORE:
                break
        return best

    def _sources(self, number: int) -> list[int]:
        """The last view the object was seen in, then the first view."""
        last = max(index for index, row in enumerate(self.found) if row[number] is not None)
        return [last, 0] if last else [0]

    def _by_flow(self, source: int, number: int) -> _Guess | None:
        if source not in self.flows:
            self.flows[source] = flow_between(self.views[source].grey, self.views[self.index].grey)
        return self._carried(self.found[source][number], self.flows[source])

    def _by_features(self, source: int, number: int) -> _Guess | None:
        """By an affine map, and flow for what it leaves; by the map alone where flow does not agree."""
        grey, mask, here = self.views[source].grey, self.found[source][number], self.views[self.index].grey
        matrix = affine_between(grey, here, mask)
        if matrix is None:
            return None
        size = here.shape[::-1]
        moved = cv2.warpAffine(mask.astype(np.float32), matrix, size) > 0.5
        if not moved.any():
            return None
        rest = flow_between(cv2.warpAffine(grey, matrix, size, borderMode=cv2.BORDER_REPLICATE), here)
        return self._carried(moved, rest) or _Guess(self._snapped(moved, 3 * SNAP_BAND), UNCHECKED)

    def _carried(self, mask: np.ndarray, flow: Flow) -> _Guess | None:
        carried = carry(mask, flow)
        if carried.consistent < MIN_CONSISTENT:
            return None
        return _Guess(self._snapped(carried.mask, SNAP_BAND, carried.mask & ~carried.sure), carried.consistent)

    def _snapped(self, mask: np.ndarray, band: float, unsure: np.ndarray | None = None) -> np.ndarray:
        """The outline on the colours of this view; as carried where graph cut would change the object itself."""
        moved = snapped(self.views[self.index].pixels, mask, band, band, rounds=2, unsure=unsure)
        sure = mask if unsure is None else mask & ~unsure
        return moved if overlap(moved | ~sure & mask, mask) > 0.7 else sure

    def _score(self, guess: _Guess, source: int, number: int) -> float:
        """Trust in a guess, in [0, 1]; 0 when it cannot be the object that earlier views show."""
        before, first = self.found[source][number], self.found[0][number]
        if _growth(before, guess.mask) > MAX_GROWTH or _growth(first, guess.mask) > MAX_TOTAL_GROWTH:
            return 0.0
        here = self.views[self.index].pixels
        likeness = max(
            _likeness(self.views[view].pixels, seen, here, guess.mask) for view, seen in ((source, before), (0, first))
        )
        return guess.consistent * likeness if likeness >= MIN_LIKENESS else 0.0


def _view(picture: np.ndarray, size: int) -> _View:
    height, width = picture.shape[:2]
    factor = min(1.0, size / max(height, width))
    shape = max(1, round(width * factor)), max(1, round(height * factor))
    small = cv2.resize(picture, shape, interpolation=cv2.INTER_AREA) if factor < 1 else picture
    pixels = np.round(np.clip(small, 0, 1) * 255).astype(np.uint8)
    return _View(pixels, cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))


def _growth(one: np.ndarray, other: np.ndarray) -> float:
    """Ratio of the areas of two masks, the larger above the smaller; infinite when one is empty."""
    smaller, larger = sorted((int(one.sum()), int(other.sum())))
    return larger / smaller if smaller else float("inf")


def _likeness(one: np.ndarray, one_mask: np.ndarray, other: np.ndarray, other_mask: np.ndarray) -> float:
    """Overlap in [0, 1] of the colour histograms of two masked regions, tolerant of slight changes of light."""
    first, second = _histogram(one, one_mask), _histogram(other, other_mask)
    return float(np.sqrt(first * second).sum())


def _histogram(pixels: np.ndarray, mask: np.ndarray) -> np.ndarray:
    lab = cv2.cvtColor(pixels, cv2.COLOR_RGB2LAB)
    counts = cv2.calcHist([lab], [0, 1, 2], mask.astype(np.uint8), [6, 16, 16], [0, 256, 0, 256, 0, 256])
    smooth = cv2.GaussianBlur(counts.reshape(6, -1), (1, 3), 0.7).reshape(6, 16, 16)
    smooth = np.stack([cv2.GaussianBlur(plane, (3, 3), 0.7) for plane in smooth])
    return smooth / max(smooth.sum(), 1e-9)
