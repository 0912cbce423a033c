"""Completes a half-measured depth map along the picture's edges, and carries it to more pixels."""

import cv2
import numpy as np
from numba import njit

__all__ = ["fill", "upsample"]

_REACH = 2000.0  # smoothness weight: a gap of some fifty pixels is bridged
_TOUCH = 15.0  # for smoothing what was measured
_COLOUR = 6.0  # 8-bit colour difference at which the smoothness falls to 1/e
_TOUCH_COLOUR = 8.0
_TRUST_IN_GUESSES = 1e-6  # of unconfirmed depths where confirmed ones are far away
_TRUST_NEARBY = 1e-4
_FEWEST_FOR_A_PLANE = 50
_PLANE_SAMPLES = 4000
_PLANE_ROUNDS = 15
_SAME_COLOUR = 0.1  # colour distance at which a small pixel's say falls to 1/e
_SAME_SURFACE = 0.04  # relative difference in inverse depth within which two pixels lie on one surface


def fill(inverse: np.ndarray, measured: np.ndarray, step: float, image: np.ndarray) -> np.ndarray:
    """Inverse depth everywhere: `inverse` lightly smoothed where `measured`, spread from there elsewhere.

    Fast global smoothing (Min et al. 2014): flat colour carries depth, edges stop it. `step` is how far apart two
    hypotheses were: smoothing by more would blur a depth edge.
    """
    guide = (np.clip(image, 0, 1) * 255).astype(np.uint8)
    median = cv2.medianBlur(inverse, 3)
    weight = measured.astype(np.float32)
    base, limits = main_plane(median, measured)
    spread = base + _weighted_smooth(median - base, weight + np.float32(_TRUST_IN_GUESSES), guide, _REACH, _COLOUR)
    smooth = _weighted_smooth(median, weight + np.float32(_TRUST_NEARBY), guide, _TOUCH, _TOUCH_COLOUR)
    touched = np.where(np.abs(smooth - median) < step, 0.5 * (smooth + median), median)
    return np.where(measured, touched, np.clip(spread, *limits)).astype(np.float32)


def main_plane(inverse: np.ndarray, measured: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """The plane nearest to most of what was measured, as inverse depth everywhere, and the range that was measured.

    Planes are linear in inverse depth. Far from anything measured the filling returns to this one: often the ground or
    a wall that goes on outside the overlap of the photos. Iteratively reweighted least squares (Cauchy).
    """
    places = np.flatnonzero(measured)
    if len(places) < _FEWEST_FOR_A_PLANE:
        return np.full_like(inverse, np.median(inverse)), (float(inverse.min()), float(inverse.max()))
    height, width = inverse.shape
    y, x = np.mgrid[:height, :width]
    basis = np.stack([x.ravel() / width - 0.5, y.ravel() / height - 0.5, np.ones(x.size)], axis=1)
    some = places[:: max(1, len(places) // _PLANE_SAMPLES)]
    values, weights = inverse.ravel()[some].astype(float), np.ones(len(some))
    scale = 0.3 * values.std() + 1e-9
    for _ in range(_PLANE_ROUNDS):
        solution = np.linalg.lstsq(basis[some] * weights[:, None], values * weights, rcond=None)[0]
        weights = 1 / (1 + ((values - basis[some] @ solution) / scale) ** 2)
    low, high = np.percentile(values, [0.5, 99.5])
    return (basis @ solution).reshape(inverse.shape).astype(np.float32), (low, high)


def _weighted_smooth(
    values: np.ndarray, weights: np.ndarray, guide: np.ndarray, strength: float, colour: float
) -> np.ndarray:
    smoother = cv2.ximgproc.createFastGlobalSmootherFilter(guide, strength, colour)
    total = smoother.filter(weights)
    return smoother.filter(values * weights) / np.maximum(total, 1e-8)


def upsample(
    inverse: np.ndarray, measured: np.ndarray, guide: np.ndarray, photo: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Depth `inverse` and `measured` of the small picture `guide` for every pixel of the large `photo`.

    Each pixel joins the surface of the nearby small pixel that looks most like it, so depth edges stay sharp: depths
    are interpolated within a surface, never across two.
    """
    if guide.shape == photo.shape:
        return inverse, measured.astype(np.float32)
    return _joint_upsample(inverse, measured.astype(np.float32), guide, np.ascontiguousarray(photo, np.float32))


@njit(cache=True, nogil=True)
def _joint_upsample(inverse, measured, guide, photo):  # pragma: no cover - compiled
    small_height, small_width = inverse.shape
    height, width = photo.shape[:2]
    result = np.empty((height, width), np.float32)
    trust = np.empty((height, width), np.float32)
    weights, depths, trusts = np.empty(4, np.float32), np.empty(4, np.float32), np.empty(4, np.float32)
    for y in range(height):
        place_y = min(max((y + 0.5) * small_height / height - 0.5, 0.0), small_height - 1.0)
        top = min(int(place_y), max(small_height - 2, 0))
        for x in range(width):
            place_x = min(max((x + 0.5) * small_width / width - 0.5, 0.0), small_width - 1.0)
            left = min(int(place_x), max(small_width - 2, 0))
            best = 0
            for corner in range(4):
                v = min(top + corner // 2, small_height - 1)
                u = min(left + corner % 2, small_width - 1)
                distance = np.float32(0)
                for channel in range(3):
                    distance += (photo[y, x, channel] - guide[v, u, channel]) ** 2
                near = max(1 - abs(place_y - v), 0.0) * max(1 - abs(place_x - u), 0.0)
                likeness = max(np.exp(-distance / _SAME_COLOUR**2), 1e-5)  # none alike: then all the same
                weights[corner] = (near + 1e-3) * likeness
                depths[corner], trusts[corner] = inverse[v, u], measured[v, u]
                if weights[corner] > weights[best]:
                    best = corner
            total, depth, certain = 1e-12, 0.0, 0.0
            for corner in range(4):
                if abs(depths[corner] - depths[best]) <= _SAME_SURFACE * depths[best]:
                    total += weights[corner]
                    depth += weights[corner] * depths[corner]
                    certain += weights[corner] * trusts[corner]
            result[y, x] = depth / total
            trust[y, x] = certain / total
    return result, trust
