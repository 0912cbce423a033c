"""Memory layouts that the numba kernels share: sizes, and what stands in which column."""

from typing import NamedTuple

import numpy as np

TILE = 16
"""Side of a tile [pixels]; a tile is TILE / BLOCK squared blocks."""
BLOCK = 4
"""Side of a block [pixels]; one block is one vector of sixteen lanes."""

LOOKAHEAD = 32
"""Spare room after lists of entries, so that kernels may ask ahead for the memory of entries to
come.
"""

# Columns of a splat's record, float32 [16], one cache line. With d = pixel - mean,
# log2(alpha) = LOG_OPACITY - (INV_STD_X * (d_x - X_PER_Y * d_y))^2 - (INV_STD_Y * d_y)^2.
RECORD = 16
_COLUMNS = list(np.arange(RECORD, dtype=np.uint64))  # as kernels index
X, X_REST, Y, Y_REST = _COLUMNS[:4]  # mean as a sum of two float32 [pixels]
X_PER_Y = _COLUMNS[4]  # d_x of the highest alpha on a row, per d_y
# 1 / standard deviation of x given y, and of y; units as in `projection.UNIT`
INV_STD_X, INV_STD_Y = _COLUMNS[5:7]
LOG_OPACITY = _COLUMNS[7]  # base 2
RED, GREEN, BLUE, DEPTH = _COLUMNS[8:12]
CUTOFF = _COLUMNS[12]  # the sum of the two squares above which alpha < min_alpha
Y_PER_X = _COLUMNS[13]  # d_y of the highest alpha on a column, per d_x
# What float32 left out of X_PER_Y; a long needle's end is far from its mean.
X_PER_Y_REST = _COLUMNS[14]

# Columns of a camera, float64: the world axes' images first (rotation of c2w, row-major), then the
# rest.
CENTRE = 9  # of the camera in the world, 3 numbers
FOCAL_X, FOCAL_Y, CENTRE_X, CENTRE_Y = 12, 13, 14, 15  # [pixels]
# where the Jacobian is not clamped [tangents]
LOW_X, HIGH_X, LOW_Y, HIGH_Y = 16, 17, 18, 19
CAMERA = 20
POSE = 16  # the first columns, by which the backward pass gives gradients

# Columns of the sums that the backward pass takes over a splat's pixels; s, t: the two terms
# squared above, in units of standard deviations, v: the gradient by the exponent sigma.
SUMS = 10
SUM_V, SUM_VS, SUM_VT, SUM_VSS, SUM_VST, SUM_VTT = _COLUMNS[:6]
SUM_RED, SUM_GREEN, SUM_BLUE, SUM_DEPTH = _COLUMNS[6:SUMS]


class GaussianArrays(NamedTuple):
    """One scene's Gaussians, or their gradients, for kernels: contiguous float32 arrays."""

    means: np.ndarray  # [G, 3]
    scales: np.ndarray  # [G, 3]
    quats: np.ndarray  # [G, 4]
    opacities: np.ndarray  # [G]
    harmonics: np.ndarray  # [G, K, 3]


class CameraImages(NamedTuple):
    """The images of one camera, or the gradients by them, as contiguous float32 arrays."""

    image: np.ndarray  # [3, H, W]
    alpha: np.ndarray  # [H, W]
    depth: np.ndarray  # [H, W]
