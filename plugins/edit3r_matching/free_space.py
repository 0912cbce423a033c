"""What a neighbour saw through must be empty: guesses that stand in its way are pushed back.

Next to a depth edge this is what occlusion means: a pixel that only one photo shows belongs to the background.
"""

import numpy as np
from numba import njit

from edit3r_matching.camera import Picture
from edit3r_matching.depth_map import RawDepth
from edit3r_matching.plane_sweep import Neighbour

__all__ = ["push_back"]

_TOLERANCE = 2.0  # planes by which a guess may stand before a neighbour's surface


def push_back(
    inverse: np.ndarray,
    measured: np.ndarray,
    own: RawDepth,
    reference: Picture,
    neighbour: Neighbour,
    other: RawDepth,
    other_measured: np.ndarray,
) -> np.ndarray:
    """`inverse` with every guess moved away from the camera until it hides nothing that the neighbour measured."""
    intrinsics, pose = neighbour.picture.intrinsics, neighbour.pose
    matrix = intrinsics @ pose.rotation @ np.linalg.inv(reference.intrinsics)
    shift = intrinsics @ pose.translation
    limit = _TOLERANCE * other.step
    return _push_back(inverse, measured, own.farthest, own.step, matrix, shift, other.inverse, other_measured, limit)


@njit(cache=True, nogil=True)
def _push_back(
    inverse, measured, farthest, step, matrix, shift, other, other_measured, limit
):  # pragma: no cover - compiled
    height, width = inverse.shape
    result = inverse.copy()
    for y in range(height):
        for x in range(width):
            if measured[y, x]:
                continue
            ray = matrix @ np.array([x + 0.5, y + 0.5, 1.0])
            guess = inverse[y, x]
            while guess > farthest and _hides(ray, guess, shift, other, other_measured, limit):
                guess -= step
            result[y, x] = max(guess, farthest)
    return result


@njit(cache=True, nogil=True)
def _hides(ray, inverse, shift, other, other_measured, limit):  # pragma: no cover - compiled
    """Whether a point at `inverse` depth along a reference ray stands before the neighbour's measured surface.

    `ray` is the pixel at infinity in the neighbour's homogeneous pixels; the point appears at `ray + inverse * shift`,
    its inverse depth there is `inverse / z`.
    """
    z = ray[2] + inverse * shift[2]
    if z <= 1e-9:
        return True  # behind the neighbour's camera
    column = int(np.floor((ray[0] + inverse * shift[0]) / z))
    row = int(np.floor((ray[1] + inverse * shift[1]) / z))
    if column < 0 or row < 0 or column >= other.shape[1] or row >= other.shape[0]:
        return False
    return other_measured[row, column] and inverse / z - other[row, column] > limit
