"""Completes a half-measured depth map along the picture's edges."""

import cv2
import numpy as np

__all__ = ["fill"]

_REACH = 2000.0  # smoothness weight: a gap of some fifty pixels is bridged
_TOUCH = 15.0  # for smoothing what was measured
_COLOUR = 6.0  # 8-bit colour difference at which the smoothness falls to 1/e
_TOUCH_COLOUR = 8.0
_TRUST_IN_GUESSES = 1e-6  # of unconfirmed depths where confirmed ones are far away
_TRUST_NEARBY = 1e-4
_FEWEST_FOR_A_PLANE = 50
_PLANE_SAMPLES = 4000
_PLANE_ROUNDS = 15


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
