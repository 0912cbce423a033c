"""Project Gaussians into packed records, all in one pass, in float64 (EWA splatting, Zwicker et al. 2001)."""

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
    TILE,
    X_REST,
    Y_REST,
    X,
    Y,
)
from edit3r_rasterizers.settings import MAX_COLOUR
from edit3r_rasterizers.sh_kernels import evaluate_basis

_LOG2E = 1.0 / math.log(2.0)
_HALF_LOG2E_ROOT = math.sqrt(0.5 * _LOG2E)
SHORTEST_QUAT = 1e-12
"""A quaternion not longer than this is taken as the identity."""


@njit(error_model="numpy")
def camera_position(camera, dx, dy, dz):
    """Camera coordinates of a world offset from the camera's centre."""
    x = camera[0] * dx + camera[3] * dy + camera[6] * dz
    y = camera[1] * dx + camera[4] * dy + camera[7] * dz
    z = camera[2] * dx + camera[5] * dy + camera[8] * dz
    return x, y, z


@njit(error_model="numpy")
def image_rows(camera, u, v, z):
    """Jacobian of the picture position by the world position [pixels / scene unit], tangents clamped."""
    u = min(max(u, camera[LOW_X]), camera[HIGH_X])
    v = min(max(v, camera[LOW_Y]), camera[HIGH_Y])
    gx, gy = camera[FOCAL_X] / z, camera[FOCAL_Y] / z
    j0, j1, j2 = (camera[0] - u * camera[2]) * gx, (camera[3] - u * camera[5]) * gx, (camera[6] - u * camera[8]) * gx
    k0, k1, k2 = (camera[1] - v * camera[2]) * gy, (camera[4] - v * camera[5]) * gy, (camera[7] - v * camera[8]) * gy
    return j0, j1, j2, k0, k1, k2


@njit(error_model="numpy")
def rotation(a, b, c, d):
    """Rotation matrix, row-major, of a wxyz quaternion of any norm, and 1 / norm (0: taken as the identity)."""
    norm = math.sqrt(a * a + b * b + c * c + d * d)
    inverse = 1.0 / norm if norm > SHORTEST_QUAT else 0.0
    b, c, d = b * inverse, c * inverse, d * inverse
    a = a * inverse if inverse > 0.0 else 1.0
    r0, r1, r2 = 1.0 - 2.0 * (c * c + d * d), 2.0 * (b * c - a * d), 2.0 * (b * d + a * c)
    r3, r4, r5 = 2.0 * (b * c + a * d), 1.0 - 2.0 * (b * b + d * d), 2.0 * (c * d - a * b)
    r6, r7, r8 = 2.0 * (b * d - a * c), 2.0 * (c * d + a * b), 1.0 - 2.0 * (b * b + c * c)
    return r0, r1, r2, r3, r4, r5, r6, r7, r8, inverse


@njit(error_model="numpy")
def conditional_form(a0, a1, a2, b0, b1, b2, eps2d):
    """(slope, narrowness, flatness, variance_x, variance_y) of the covariance of rows a (x) and b (y).

    The variance of x given y is det / variance_y, with the determinant as a sum of squares: |a x b|^2 + ...
    """
    square = a0 * a0 + a1 * a1 + a2 * a2
    variance_x, variance_y = square + eps2d, b0 * b0 + b1 * b1 + b2 * b2 + eps2d
    root = math.sqrt(variance_y)
    flatness = 1.0 / root
    b0, b1, b2 = b0 * flatness, b1 * flatness, b2 * flatness
    e0, e1, e2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    given = e0 * e0 + e1 * e1 + e2 * e2 + eps2d * (1.0 + square * flatness * flatness)
    slope = (a0 * b0 + a1 * b1 + a2 * b2) * flatness
    return slope, 1.0 / math.sqrt(given), flatness, variance_x, variance_y


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
    count = harmonics.shape[1]
    basis = np.empty(25)
    sound = True
    for i in range(np.uint64(first), np.uint64(last)):
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = 1, 1, 0, 0
        px, py, pz = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        s0, s1, s2 = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
        qa, qb = np.float64(quats[i, 0]), np.float64(quats[i, 1])
        qc, qd = np.float64(quats[i, 2]), np.float64(quats[i, 3])
        opacity = np.float64(opacities[i])
        total = px + py + pz + s0 + s1 + s2 + qa + qb + qc + qd + opacity
        for k in range(np.uint64(count)):
            total += np.float64(harmonics[i, k, 0]) + np.float64(harmonics[i, k, 1]) + np.float64(harmonics[i, k, 2])
        if not math.isfinite(total):  # sums of float32 cannot overflow float64
            sound = False
            continue
        dx, dy, dz = px - camera[CENTRE], py - camera[CENTRE + 1], pz - camera[CENTRE + 2]
        x, y, z = camera_position(camera, dx, dy, dz)
        if z < near or z > far or opacity < min_alpha:
            continue
        u, v = x / z, y / z
        r0, r1, r2, r3, r4, r5, r6, r7, r8, _ = rotation(qa, qb, qc, qd)
        j0, j1, j2, k0, k1, k2 = image_rows(camera, u, v, z)
        a0, b0 = (j0 * r0 + j1 * r3 + j2 * r6) * s0, (k0 * r0 + k1 * r3 + k2 * r6) * s0
        a1, b1 = (j0 * r1 + j1 * r4 + j2 * r7) * s1, (k0 * r1 + k1 * r4 + k2 * r7) * s1
        a2, b2 = (j0 * r2 + j1 * r5 + j2 * r8) * s2, (k0 * r2 + k1 * r5 + k2 * r8) * s2
        slope, narrowness, flatness, variance_x, variance_y = conditional_form(a0, a1, a2, b0, b1, b2, eps2d)
        mean_x, mean_y = camera[FOCAL_X] * u + camera[CENTRE_X], camera[FOCAL_Y] * v + camera[CENTRE_Y]
        reach = 2.0 * math.log(opacity / min_alpha)
        extent_x, extent_y = math.sqrt(reach * variance_x), math.sqrt(reach * variance_y)
        left, top = math.ceil(max(mean_x - extent_x - 0.5, 0.0)), math.ceil(max(mean_y - extent_y - 0.5, 0.0))
        right = math.floor(min(mean_x + extent_x - 0.5, width - 1.0))
        bottom = math.floor(min(mean_y + extent_y - 0.5, height - 1.0))
        if left > right or top > bottom:
            continue
        boxes[i, 0], boxes[i, 1] = int(left) // TILE, int(top) // TILE
        boxes[i, 2], boxes[i, 3] = int(right) // TILE, int(bottom) // TILE
        keys[i] = z
        record = records[i]
        record[X], record[Y] = mean_x, mean_y
        record[X_REST], record[Y_REST] = mean_x - np.float64(record[X]), mean_y - np.float64(record[Y])
        record[SLOPE] = slope
        record[NARROWNESS], record[FLATNESS] = narrowness * _HALF_LOG2E_ROOT, flatness * _HALF_LOG2E_ROOT
        record[LOG_OPACITY], record[REACH] = math.log(opacity) * _LOG2E, 0.5 * _LOG2E * reach
        record[LEAN] = slope * variance_y / variance_x
        record[DEPTH] = z
        inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        evaluate_basis(dx * inverse, dy * inverse, dz * inverse, count, basis)
        for channel in range(3):
            colour = 0.5
            for k in range(np.uint64(count)):
                colour += basis[k] * np.float64(harmonics[i, k, channel])
            record[RED + channel] = min(max(colour, 0.0), MAX_COLOUR)
    return sound
