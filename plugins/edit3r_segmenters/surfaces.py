"""What depth says of an image at working size: surfaces that end at steps, large planes, and what
stands before what is behind it.

Planes are linear in inverse depth over an image, so steps and planes are told in inverse depth, as
shares of it. Depth is smeared at thin parts and planes run through things, so surfaces are no
answers; they are votes on the answers of others.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from edit3r_segmenters.masks import overlap

STEPS = (0.01, 0.02, 0.03, 0.05, 0.08)  # of inverse depth, at which a surface may end
AREAS = (0.001, 0.6)  # shares of the image that a surface may cover
SAME = 0.85  # overlap from which two surfaces are one
MAX_SURFACES = 3  # at a place
NEAR = 6  # pixels from a place to the surface that is meant
ON_PLANE = 0.015
LARGE = 0.12  # share of the image from which a plane may hold things up
MAX_PLANES = 3
TRIED = 400  # planes through three points
SAMPLES = 3000
CLEAR_STEP = (
    0.05  # in log inverse depth, from which a thing stands clearly before others
)
BESIDE = 9  # side of the windows that are compared across an outline [pixels]


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Depth of an image at working size."""

    inverse: np.ndarray  # [h, w] inverse depth
    measured: np.ndarray  # [h, w] bool

    @classmethod
    def of(
        cls, depth: np.ndarray, measured: np.ndarray, shape: tuple[int, int]
    ) -> "Surfaces":
        """From camera z of any size."""
        size = shape[::-1]
        z = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
        known = cv2.resize(
            measured.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST
        )
        inverse = (1 / np.maximum(z, 1e-6)).astype(np.float32)
        return cls(cv2.medianBlur(inverse, 3), known > 0)

    def at(self, place: tuple[int, int]) -> list[np.ndarray]:
        """Bool masks of the surfaces at a place that differ: up to steps of several heights, with
        large planes that the place is not on, and without.
        """
        found: list[np.ndarray] = []
        for part in self._parts(place):
            usual = AREAS[0] < part.mean() < AREAS[1]
            if usual and all(overlap(part, other) < SAME for other in found):
                found.append(part)
            if len(found) == MAX_SURFACES:
                break
        return found

    def before(self, mask: np.ndarray) -> float:
        """How much nearer a bool mask lies along its outline than what is beside it: 1 a clear step
        in front, 0 behind, 0.5 where there is no step or no outline.
        """
        window = (BESIDE, BESIDE)
        inside = mask.astype(np.float32)

        def summed(values: np.ndarray) -> np.ndarray:
            return cv2.boxFilter(values, -1, window, normalize=False)

        within, beyond = summed(inside), summed(1 - inside)
        ring = cv2.morphologyEx(inside, cv2.MORPH_GRADIENT, np.ones((3, 3))) > 0
        ring &= (within > 3) & (beyond > 3)
        ring[:3] = ring[-3:] = ring[:, :3] = ring[:, -3:] = False
        if ring.sum() < 8:
            return 0.5
        values = self._logarithm
        nearer = summed(values * inside) / np.maximum(within, 1)
        nearer -= summed(values * (1 - inside)) / np.maximum(beyond, 1)
        return float(np.clip(nearer[ring] / CLEAR_STEP, -1, 1).mean() + 1) / 2

    @cached_property
    def _logarithm(self) -> np.ndarray:
        return np.log(np.maximum(self.inverse, 1e-9)).astype(np.float32)

    @cached_property
    def _step(self) -> np.ndarray:
        """Largest step to the next pixel below and to the right, and from those before."""
        found = np.zeros_like(self.inverse)
        for axis in (0, 1):
            first, second = self._neighbours(axis)
            step = np.abs(second - first) / np.maximum(first, second)
            ahead, behind = [(0, 0), (0, 0)], [(0, 0), (0, 0)]
            ahead[axis], behind[axis] = (0, 1), (1, 0)
            found = np.maximum(found, np.pad(step, ahead))
            found = np.maximum(found, np.pad(step, behind))
        return found

    def _neighbours(self, axis: int) -> tuple[np.ndarray, np.ndarray]:
        count = self.inverse.shape[axis]
        first = np.take(self.inverse, range(count - 1), axis)
        return first, np.take(self.inverse, range(1, count), axis)

    def _parts(self, place: tuple[int, int]) -> Iterator[np.ndarray]:
        support = self._support(place)
        for kept_out in (support, np.zeros_like(support)):
            for step in STEPS:
                part = _joined(~((self._step > step) | kept_out), place)
                if part is not None:
                    yield part

    def _support(self, place: tuple[int, int]) -> np.ndarray:
        """Large planes that the place does not lie on."""
        taken = np.zeros(self.inverse.shape, dtype=bool)
        row, column = place
        near = np.s_[max(0, row - 2) : row + 3, max(0, column - 2) : column + 3]
        for on, plane in self._planes:
            away = np.abs(self.inverse[near] / plane[near] - 1)
            if np.median(away) > 1.5 * ON_PLANE:
                taken |= on
        return taken

    @cached_property
    def _planes(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Pixels on each of the largest planes, and its inverse depth over the whole image."""
        height, width = self.inverse.shape
        rows, columns = np.mgrid[:height, :width]
        everywhere = np.stack(
            [columns / width, rows / height, np.ones_like(rows, float)], -1
        )
        random = np.random.default_rng(0)
        index = np.flatnonzero(self.measured)
        if len(index) < 500:
            return []
        index = random.choice(index, min(SAMPLES, len(index)), replace=False)
        places = everywhere.reshape(-1, 3)[index]
        values = self.inverse.ravel()[index].astype(float)
        found = []
        for _ in range(MAX_PLANES):
            if len(values) < 200:
                break
            fit = _plane(places, values, random)
            plane = everywhere @ fit
            on = (np.abs(plane / self.inverse - 1) < ON_PLANE) & (plane > 0)
            if on.mean() < LARGE:
                break
            bits = cv2.morphologyEx(
                on.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3))
            )
            found.append((bits > 0, np.where(plane > 0, plane, np.inf)))
            left = np.abs(places @ fit / values - 1) >= ON_PLANE
            places, values = places[left], values[left]
        return found


def _joined(free: np.ndarray, place: tuple[int, int]) -> np.ndarray | None:
    """The part of a bool mask at a place or close to it, its gaps closed; None where none is."""
    bits = cv2.morphologyEx(free.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3)))
    if not bits[place]:
        rows, columns = np.nonzero(bits)
        if not len(rows):
            return None
        away = np.hypot(rows - place[0], columns - place[1])
        nearest = away.argmin()
        if away[nearest] > NEAR:
            return None
        place = (rows[nearest], columns[nearest])
    labels = cv2.connectedComponents(bits, connectivity=4)[1]
    part = (labels == labels[place]).astype(np.uint8)
    return cv2.morphologyEx(part, cv2.MORPH_CLOSE, np.ones((5, 5))) > 0


def _plane(
    places: np.ndarray, values: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """The plane `[3]` that most points lie on: the best of many through three, then fitted."""
    three = random.integers(0, len(values), (TRIED, 3))
    normal = np.linalg.det(places[three])
    three = three[np.abs(normal) > 1e-9]
    fits = np.linalg.solve(places[three], values[three][..., None])[..., 0]
    near = np.abs(fits @ places.T / values - 1) < ON_PLANE
    fit = fits[near.sum(1).argmax()]
    for _ in range(3):
        on = np.abs(places @ fit / values - 1) < ON_PLANE
        fit = np.linalg.lstsq(
            places[on] / values[on, None], np.ones(on.sum()), rcond=None
        )[0]
    return fit
