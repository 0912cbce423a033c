"""Semi-global matching (Hirschmueller 2008): costs are aggregated along eight paths that end at
each pixel.

Changing depth by one plane between neighbours costs `SMALL_STEP`, by more a jump cost that falls
where the image has an edge, since depth edges are usually seen.
"""

import cv2
import numpy as np
from jaxtyping import Float

from edit3r.kit.compute.compiling import compiled

# The numbers of this block: no figures kept.
SMALL_STEP = 0.08
LEAST_JUMP = 1.5 * SMALL_STEP
JUMP = 0.6  # more than the least, in flat regions
EDGE = 0.08  # grey-value gradient at which the jump cost has fallen to 1/e
BIG = 1e9


def aggregate(
    cost: Float[np.ndarray, "height width plane"],
    grey: Float[np.ndarray, "height width"],
) -> Float[np.ndarray, "height width plane"]:
    """Sum of the eight path costs, float32, for costs of about [0, 1]."""
    cost = np.ascontiguousarray(cost, np.float32)
    jump = _jump_costs(np.ascontiguousarray(grey, np.float32))
    total = np.zeros_like(cost)
    for backwards in (False, True):
        _four_paths(cost, jump, np.float32(SMALL_STEP), backwards, total)
    return total


def _jump_costs(
    grey: Float[np.ndarray, "height width"],
) -> Float[np.ndarray, "height width"]:
    """What a change by more than one plane costs at each pixel."""
    gradient = (
        np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
        / 4
    )
    return (LEAST_JUMP + JUMP * np.exp(-gradient / EDGE)).astype(np.float32)


@compiled(fastmath=True, nogil=True)
def _four_paths(
    cost, jump, small_step, backwards, total
):  # pragma: no cover - compiled
    """Paths from the previous pixel of the row and from three of the previous row, in order."""
    height, width, planes = cost.shape
    # Row buffers are padded by one plane and one pixel on either side, so that no border needs a
    # test.
    above = np.full((3, width + 2, planes + 2), np.float32(BIG))
    above_least = np.zeros((3, width + 2), np.float32)
    below = np.full((3, width + 2, planes + 2), np.float32(BIG))
    below_least = np.zeros((3, width + 2), np.float32)
    beside = np.full((2, planes + 2), np.float32(BIG))
    for row in range(height):
        y = height - 1 - row if backwards else row
        previous_y = y + 1 if backwards else y - 1
        least = np.float32(0)
        for column in range(width):
            x = width - 1 - column if backwards else column
            slot, out = column % 2, total[y, x]
            if column == 0:
                least = _start_path(cost[y, x], beside[slot], out)
            else:
                previous_x = x + 1 if backwards else x - 1
                penalty = min(jump[y, x], jump[y, previous_x])
                least = _extend(
                    cost[y, x],
                    beside[1 - slot],
                    least,
                    small_step,
                    penalty,
                    beside[slot],
                    out,
                )
            for path in range(3):
                source = column + path - 1
                if row == 0 or source < 0 or source >= width:
                    below_least[path, column + 1] = _start_path(
                        cost[y, x], below[path, column + 1], out
                    )
                    continue
                source_x = width - 1 - source if backwards else source
                penalty = min(jump[y, x], jump[previous_y, source_x])
                below_least[path, column + 1] = _extend(
                    cost[y, x],
                    above[path, source + 1],
                    above_least[path, source + 1],
                    small_step,
                    penalty,
                    below[path, column + 1],
                    out,
                )
        above, below = below, above
        above_least, below_least = below_least, above_least


@compiled(fastmath=True, nogil=True)
def _start_path(cost, path, total):  # pragma: no cover - compiled
    least = np.float32(BIG)
    for d in range(cost.shape[0]):
        value = cost[d]
        path[d + 1] = value
        total[d] += value
        least = min(least, value)
    return least


@compiled(fastmath=True, nogil=True)
def _extend(
    cost, previous, previous_least, small_step, jump, path, total
):  # pragma: no cover - compiled
    """One step of Hirschmueller's equation 13; returns the least value of the new path costs."""
    least = np.float32(BIG)
    limit = previous_least + jump
    for d in range(cost.shape[0]):
        step = min(previous[d], previous[d + 2]) + small_step
        value = cost[d] + min(min(previous[d + 1], step), limit) - previous_least
        path[d + 1] = value
        total[d] += value
        least = min(least, value)
    return least


@compiled(nogil=True)
def best_plane(total):  # pragma: no cover - compiled
    """Position of the least cost `[height, width]` in planes, refined by a parabola."""
    height, width, planes = total.shape
    position = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            row = total[y, x]
            best = 0
            for d in range(1, planes):
                if row[d] < row[best]:
                    best = d
            offset = np.float32(0)
            if 0 < best < planes - 1:
                curvature = row[best - 1] + row[best + 1] - 2 * row[best]
                if curvature > 1e-9:
                    offset = (
                        np.float32(0.5) * (row[best - 1] - row[best + 1]) / curvature
                    )
            position[y, x] = best + min(max(offset, np.float32(-0.5)), np.float32(0.5))
    return position
