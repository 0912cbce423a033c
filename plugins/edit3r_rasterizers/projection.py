"""Project Gaussians into packed records, eight at a time, in float64 (EWA splatting, Zwicker et al. 2001).

The maths is written once for scalars and vectors alike: the small functions here work on float64 and on `DOUBLES`.
"""

import math

import numpy as np
from numba import njit

from edit3r_rasterizers.records import (
    CENTRE,
    CENTRE_X,
    CENTRE_Y,
    DEPTH,
    FLATNESS,
    FOCAL_X,
    FOCAL_Y,
    HIGH_X,
    HIGH_Y,
    LEAN,
    LOG_OPACITY,
    LOW_X,
    LOW_Y,
    NARROWNESS,
    REACH,
    RED,
    SLOPE,
    SLOPE_REST,
    TILE,
    X_REST,
    Y_REST,
    X,
    Y,
)
from edit3r_rasterizers.settings import MAX_COLOUR
from edit3r_rasterizers.sh_kernels import evaluate_basis
from edit3r_rasterizers.simd import broadcast, mask_bits, maximum, minimum, select, square_root
from edit3r_rasterizers.simd_math import log2
from edit3r_rasterizers.simd_memory import load, store

SHORTEST_QUAT = 1e-12
"""A quaternion not longer than this is taken as the identity."""
UNIT = math.sqrt(0.5 / math.log(2.0))
"""The records' squares are exponents of two: standard deviations times this."""
_DEVIATIONS = 1 / UNIT

U = np.uint64
GROUP = U(8)
MEAN, SCALE, QUAT, OPACITY, INPUTS = U(0), U(3), U(6), U(10), U(11)
"""Rows of the staged inputs, one lane per Gaussian."""
_X, _Y, _SLOPE, _NARROWNESS, _FLATNESS, _LEAN, _LOG_OPACITY, _REACH, _DEPTH = (U(row) for row in range(9))
_LEFT, _TOP, _RIGHT, _BOTTOM, _EAST, _DOWN, _AHEAD, _OUTPUTS = (U(row) for row in range(9, 17))
"""Rows of the staged results; the last three are the direction seen."""


@njit(error_model="numpy")
def stage(staged, lane, i, means, scales, quats, opacities):
    """Copy the geometry of Gaussian `i` to one lane of the staged inputs."""
    for k in range(U(3)):
        staged[(MEAN + k) * GROUP + lane] = means[i, k]
        staged[(SCALE + k) * GROUP + lane] = scales[i, k]
    for k in range(U(4)):
        staged[(QUAT + k) * GROUP + lane] = quats[i, k]
    staged[OPACITY * GROUP + lane] = opacities[i]


@njit(error_model="numpy")
def staged_row(staged, row):
    """Eight lanes of one row."""
    return load(staged, row * GROUP)


@njit(error_model="numpy")
def offset_from_camera(staged, camera):
    """World offset of the means from the camera's centre; subtracted first, which is exact far from the origin."""
    x = staged_row(staged, MEAN) - camera[CENTRE]
    y = staged_row(staged, MEAN + U(1)) - camera[CENTRE + 1]
    z = staged_row(staged, MEAN + U(2)) - camera[CENTRE + 2]
    return x, y, z


@njit(error_model="numpy")
def camera_position(camera, dx, dy, dz):
    """Camera coordinates of a world offset from the camera's centre."""
    x = dx * camera[0] + dy * camera[3] + dz * camera[6]
    y = dx * camera[1] + dy * camera[4] + dz * camera[7]
    z = dx * camera[2] + dy * camera[5] + dz * camera[8]
    return x, y, z


@njit(error_model="numpy")
def image_rows(camera, u, v, per_z):
    """Jacobian of the picture position by the world position [pixels / scene unit], tangents clamped."""
    u = minimum(maximum(u, camera[LOW_X]), camera[HIGH_X])
    v = minimum(maximum(v, camera[LOW_Y]), camera[HIGH_Y])
    gx, gy = per_z * camera[FOCAL_X], per_z * camera[FOCAL_Y]
    j0, j1, j2 = (camera[0] - u * camera[2]) * gx, (camera[3] - u * camera[5]) * gx, (camera[6] - u * camera[8]) * gx
    k0, k1, k2 = (camera[1] - v * camera[2]) * gy, (camera[4] - v * camera[5]) * gy, (camera[7] - v * camera[8]) * gy
    return j0, j1, j2, k0, k1, k2


@njit(error_model="numpy")
def unit_quats(staged):
    """Unit quaternions and 1 / norm, or the identity and 0 for one not longer than SHORTEST_QUAT."""
    a, b = staged_row(staged, QUAT), staged_row(staged, QUAT + U(1))
    c, d = staged_row(staged, QUAT + U(2)), staged_row(staged, QUAT + U(3))
    norm = square_root(a * a + b * b + c * c + d * d)
    sound = norm > SHORTEST_QUAT
    inverse = select(sound, 1.0 / maximum(norm, SHORTEST_QUAT), broadcast(0.0))
    return select(sound, a * inverse, broadcast(1.0)), b * inverse, c * inverse, d * inverse, inverse


@njit(error_model="numpy")
def rotation_matrix(a, b, c, d):
    """Rotation matrix, row-major, of a unit wxyz quaternion."""
    r0, r1, r2 = 1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)
    r3, r4, r5 = 2.0 * (b * c + a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b)
    r6, r7, r8 = 2.0 * (b * d - a * c), 2.0 * (c * d + a * b), 1.0 - 2.0 * (b * b + c * c)
    return r0, r1, r2, r3, r4, r5, r6, r7, r8


@njit(error_model="numpy")
def conditional_form(a0, a1, a2, b0, b1, b2, eps2d):
    """(slope, narrowness, flatness, variance_x, variance_y) of the covariance of rows a (x) and b (y).

    The variance of x given y is det / variance_y, with the determinant as a sum of squares: |a x b|^2 + ...
    """
    square = a0 * a0 + a1 * a1 + a2 * a2
    variance_x, variance_y = square + eps2d, b0 * b0 + b1 * b1 + b2 * b2 + eps2d
    flatness = 1.0 / square_root(variance_y)
    b0, b1, b2 = b0 * flatness, b1 * flatness, b2 * flatness
    e0, e1, e2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    given = e0 * e0 + e1 * e1 + e2 * e2 + (square * flatness * flatness + 1.0) * eps2d
    slope = (a0 * b0 + a1 * b1 + a2 * b2) * flatness
    return slope, 1.0 / square_root(given), flatness, variance_x, variance_y


@njit(cache=True, error_model="numpy", nogil=True)
def project(
    first,
    last,
    means,
    scales,
    quats,
    opacities,
    harmonics,
    camera,
    width,
    height,
    near,
    far,
    eps2d,
    min_alpha,
    records,
    boxes,
    keys,
):
    """Fill `records`, `boxes` (first and last tile column and row) and `keys` (sort by these) for [first, last).

    A Gaussian that covers no pixel centre gets an empty box. Returns whether all values read were finite.
    """
    staged, results = np.empty(INPUTS * GROUP), np.empty(_OUTPUTS * GROUP)
    basis = np.empty(25)
    sound = True
    for start in range(U(first), U(last), GROUP):
        end = min(start + GROUP, U(last))
        for lane in range(GROUP):  # a short group repeats its last Gaussian
            stage(staged, lane, min(start + lane, end - U(1)), means, scales, quats, opacities)
        visible, finite = _project_group(staged, results, camera, width, height, near, far, eps2d, min_alpha)
        for i in range(start, end):
            lane = i - start
            colours_finite = _all_finite(harmonics, i)
            sound = sound and colours_finite and (finite >> lane) & U(1) != U(0)
            if (visible >> lane) & U(1) != U(0):
                keys[i] = results[_DEPTH * GROUP + lane]
                _write_box(boxes, i, results, lane)
                _write_geometry(records, i, results, lane)
                _write_colour(records, i, results, lane, harmonics, basis)
            else:
                boxes[i, U(0)], boxes[i, U(1)], boxes[i, U(2)], boxes[i, U(3)] = 1, 1, 0, 0
    return sound


@njit(error_model="numpy")
def _project_group(staged, results, camera, width, height, near, far, eps2d, min_alpha):
    """Eight Gaussians to `results`; returns which are visible and which are finite, as bits."""
    total = broadcast(0.0)
    for row in range(INPUTS):
        total += staged_row(staged, row) * 0.0  # stays 0 unless something is not finite
    finite = total >= 0.0
    dx, dy, dz = offset_from_camera(staged, camera)
    x, y, z = camera_position(camera, dx, dy, dz)
    opacity = staged_row(staged, OPACITY)
    seen = finite & (z >= near) & (broadcast(far) >= z) & (opacity >= min_alpha)
    z = maximum(z, near)  # lanes that are not seen stay harmless
    per_z = 1.0 / z
    u, v = x * per_z, y * per_z
    a, b, c, d, _ = unit_quats(staged)
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = rotation_matrix(a, b, c, d)
    j0, j1, j2, k0, k1, k2 = image_rows(camera, u, v, per_z)
    s0, s1, s2 = staged_row(staged, SCALE), staged_row(staged, SCALE + U(1)), staged_row(staged, SCALE + U(2))
    a0, b0 = (j0 * r0 + j1 * r3 + j2 * r6) * s0, (k0 * r0 + k1 * r3 + k2 * r6) * s0
    a1, b1 = (j0 * r1 + j1 * r4 + j2 * r7) * s1, (k0 * r1 + k1 * r4 + k2 * r7) * s1
    a2, b2 = (j0 * r2 + j1 * r5 + j2 * r8) * s2, (k0 * r2 + k1 * r5 + k2 * r8) * s2
    slope, narrowness, flatness, variance_x, variance_y = conditional_form(a0, a1, a2, b0, b1, b2, eps2d)
    mean_x, mean_y = u * camera[FOCAL_X] + camera[CENTRE_X], v * camera[FOCAL_Y] + camera[CENTRE_Y]

    opacity = maximum(opacity, min_alpha)
    log_opacity = log2(opacity)
    reach = maximum(log_opacity - log2(broadcast(min_alpha)), 0.0)
    extent_x, extent_y = square_root(reach * variance_x) * _DEVIATIONS, square_root(reach * variance_y) * _DEVIATIONS
    # Bounds in pixel indices, of pixels whose centres lie inside; clamped, so that they fit an integer.
    left, right = maximum(mean_x - extent_x - 0.5, 0.0), minimum(mean_x + extent_x - 0.5, width - 1.0)
    top, bottom = maximum(mean_y - extent_y - 0.5, 0.0), minimum(mean_y + extent_y - 0.5, height - 1.0)
    seen = seen & (right >= left) & (bottom >= top)

    store(results, _X * GROUP, mean_x)
    store(results, _Y * GROUP, mean_y)
    store(results, _SLOPE * GROUP, slope)
    store(results, _NARROWNESS * GROUP, narrowness * UNIT)
    store(results, _FLATNESS * GROUP, flatness * UNIT)
    store(results, _LEAN * GROUP, slope * variance_y / variance_x)
    store(results, _LOG_OPACITY * GROUP, log_opacity)
    store(results, _REACH * GROUP, reach)
    store(results, _DEPTH * GROUP, z)
    store(results, _LEFT * GROUP, left)
    store(results, _TOP * GROUP, top)
    store(results, _RIGHT * GROUP, right)
    store(results, _BOTTOM * GROUP, bottom)
    shorten = 1.0 / square_root(dx * dx + dy * dy + dz * dz)
    store(results, _EAST * GROUP, dx * shorten)
    store(results, _DOWN * GROUP, dy * shorten)
    store(results, _AHEAD * GROUP, dz * shorten)
    return mask_bits(seen), mask_bits(finite)


@njit(error_model="numpy")
def _all_finite(harmonics, i):
    total = 0.0
    for k in range(U(harmonics.shape[1])):
        for channel in range(U(3)):
            total += np.float64(harmonics[i, k, channel])  # float32 cannot overflow a float64 sum
    return math.isfinite(total)


@njit(error_model="numpy")
def _write_box(boxes, i, results, lane):
    """First and last tile; first > last when no pixel centre lies between the bounds."""
    left, top = math.ceil(results[_LEFT * GROUP + lane]), math.ceil(results[_TOP * GROUP + lane])
    right, bottom = math.floor(results[_RIGHT * GROUP + lane]), math.floor(results[_BOTTOM * GROUP + lane])
    empty = left > right or top > bottom
    boxes[i, U(0)], boxes[i, U(1)] = (1, 1) if empty else (int(left) // TILE, int(top) // TILE)
    boxes[i, U(2)], boxes[i, U(3)] = (0, 0) if empty else (int(right) // TILE, int(bottom) // TILE)


@njit(error_model="numpy")
def _write_geometry(records, i, results, lane):
    x, y, slope = results[_X * GROUP + lane], results[_Y * GROUP + lane], results[_SLOPE * GROUP + lane]
    records[i, U(X)], records[i, U(Y)], records[i, U(SLOPE)] = x, y, slope
    records[i, U(X_REST)] = x - np.float64(np.float32(x))
    records[i, U(Y_REST)] = y - np.float64(np.float32(y))
    records[i, U(SLOPE_REST)] = slope - np.float64(np.float32(slope))
    records[i, U(NARROWNESS)] = results[_NARROWNESS * GROUP + lane]
    records[i, U(FLATNESS)] = results[_FLATNESS * GROUP + lane]
    records[i, U(LOG_OPACITY)] = results[_LOG_OPACITY * GROUP + lane]
    records[i, U(LEAN)] = results[_LEAN * GROUP + lane]
    records[i, U(REACH)] = results[_REACH * GROUP + lane]
    records[i, U(DEPTH)] = results[_DEPTH * GROUP + lane]


@njit(error_model="numpy")
def _write_colour(records, i, results, lane, harmonics, basis):
    count = U(harmonics.shape[1])
    east, down, ahead = results[_EAST * GROUP + lane], results[_DOWN * GROUP + lane], results[_AHEAD * GROUP + lane]
    evaluate_basis(east, down, ahead, count, basis)
    for channel in range(U(3)):
        colour = 0.5
        for k in range(count):
            colour += basis[k] * np.float64(harmonics[i, k, channel])
        records[i, U(RED) + channel] = min(max(colour, 0.0), MAX_COLOUR)
