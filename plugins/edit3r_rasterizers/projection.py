"""Project Gaussians into packed records (EWA splatting, Zwicker et al. 2001)."""

import math

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import DC, Cameras
from edit3r_rasterizers import layout, projection_maths as maths
from edit3r_rasterizers.kernels import inlined, kernel
from edit3r_rasterizers.projection_maths import GROUP, INPUTS, OPACITY, U, staged_row
from edit3r_rasterizers.settings import BORDER, MAX_COLOUR
from edit3r_rasterizers.sh_kernels import evaluate_basis
from edit3r_rasterizers.simd import (
    broadcast,
    log2,
    mask_bits,
    maximum,
    minimum,
    square_root,
)
from edit3r_rasterizers.simd_memory import flat, shifted, store

UNIT = math.sqrt(0.5 / math.log(2.0))
"""Factor from standard deviations to the records' unit, whose squares are exponents of two.
Formula.
"""
_DEVIATIONS = 1 / UNIT

_X, _Y, _X_PER_Y, _INV_STD_X, _INV_STD_Y, _Y_PER_X, _LOG_OPACITY, _CUTOFF, _DEPTH = (
    INPUTS + U(row) for row in range(9)
)
_LEFT, _TOP, _RIGHT, _BOTTOM, _DIRECTION_X, _DIRECTION_Y, _DIRECTION_Z = (
    INPUTS + U(row) for row in range(9, 16)
)
"""Rows of the staged results; the last three are the direction seen."""
_BASIS = INPUTS + U(16)
PROJECTION_SCRATCH = int(_BASIS * GROUP) + 25
"""Doubles of scratch memory that `project` needs: the rows above, then one direction's harmonics
basis.
"""


def pack_cameras(cameras: Cameras) -> Float[Tensor, "batch camera column"]:
    """Pack cameras as the kernels read them, see `layout.CAMERA`: float64, on the CPU.

    The limits of the tangents are constants to autograd: the kernels' gradients by focal lengths
    and principal point include what passes through them.
    """
    c2w = cameras.c2w.to("cpu", torch.float64)
    intrinsics = cameras.intrinsics.to("cpu", torch.float64)
    height, width = cameras.image_size
    size = intrinsics.new_tensor([width, height])
    focal = intrinsics[..., [0, 1], [0, 1]] * size
    centre = intrinsics[..., :2, 2] * size
    margin = BORDER * 0.5 * size / focal
    low, high = -(centre / focal + margin), (size - centre) / focal + margin
    limits = torch.stack((low, high), -1).flatten(-2).detach()
    rotation = c2w[..., :3, :3].flatten(-2)
    return torch.cat((rotation, c2w[..., :3, 3], focal, centre, limits), -1)


@kernel
def project(first, last, gaussians, camera, limits, scratch, records, boxes, keys):
    """Fill `records`, `boxes` (first and last tile column and row) and `keys` (sort by these) for
    [first, last).

    `limits` are width, height, near, far, eps2d and min_alpha. A Gaussian that covers no pixel
    centre gets an empty box. Returns whether all values read were finite.
    """
    count = U(gaussians.harmonics.shape[1])
    gaussians, camera, scratch = flat(gaussians), flat(camera), flat(scratch)
    records, boxes, keys = flat((records, boxes, keys))
    harmonics = gaussians.harmonics
    sound = True
    for start in range(U(first), U(last), GROUP):
        end = min(start + GROUP, U(last))
        for lane in range(GROUP):  # a short group repeats its last Gaussian
            maths.stage(scratch, lane, min(start + lane, end - U(1)), gaussians)
        visible, finite = _project_group(scratch, camera, limits)
        for i in range(start, end):
            lane = i - start
            sound = sound and (finite >> lane) & U(1) != U(0)
            if (visible >> lane) & U(1) != U(0):
                keys[i] = scratch[_DEPTH * GROUP + lane]
                _write_box(boxes, i, scratch, lane)
                _write_geometry(records, i, scratch, lane)
                known = _write_colour(records, i, scratch, lane, harmonics, count)
            else:
                _write_box_of(boxes, i, 1, 1, 0, 0)
                known = _all_finite(harmonics, i, count)
            sound = known and sound
    return sound


@inlined
def _project_group(staged, camera, limits):
    """Project eight staged Gaussians; returns which are visible and which are finite, as bits."""
    width, height, near, far, eps2d, min_alpha = limits
    total = broadcast(0.0)
    for row in range(INPUTS):
        total += staged_row(staged, row) * 0.0  # stays 0 unless something is not finite
    finite = total >= 0.0
    dx, dy, dz = maths.offset_from_camera(staged, camera)
    x, y, z = maths.camera_position(camera, dx, dy, dz)
    opacity = staged_row(staged, OPACITY)
    seen = finite & (z >= near) & (broadcast(far) >= z) & (opacity >= min_alpha)
    z = maximum(z, near)  # lanes that are not seen stay harmless
    per_z = 1.0 / z
    u, v = x * per_z, y * per_z
    a, b, c, d, _ = maths.unit_quats(staged)
    rotation = maths.rotation_matrix(a, b, c, d)
    rows = maths.image_rows(camera, u, v, per_z)
    s0, s1, s2 = maths.staged_scales(staged)
    m0, m1, m2, n0, n1, n2 = maths.jacobian_rotation_rows(rows, rotation)
    a0, a1, a2, b0, b1, b2 = m0 * s0, m1 * s1, m2 * s2, n0 * s0, n1 * s1, n2 * s2
    x_per_y, inv_std_x, inv_std_y, variance_x, variance_y = maths.factorised_conic(
        a0, a1, a2, b0, b1, b2, eps2d
    )
    mean_x = u * camera[layout.FOCAL_X] + camera[layout.CENTRE_X]
    mean_y = v * camera[layout.FOCAL_Y] + camera[layout.CENTRE_Y]

    opacity = maximum(opacity, min_alpha)
    log_opacity = log2(opacity)
    cutoff = maximum(log_opacity - log2(broadcast(min_alpha)), 0.0)
    extent_x = square_root(cutoff * variance_x) * _DEVIATIONS
    extent_y = square_root(cutoff * variance_y) * _DEVIATIONS
    # Bounds in pixel indices, of pixels whose centres lie inside; clamped, so that they fit an
    # integer.
    left = maximum(mean_x - extent_x - 0.5, 0.0)
    right = minimum(mean_x + extent_x - 0.5, width - 1.0)
    top = maximum(mean_y - extent_y - 0.5, 0.0)
    bottom = minimum(mean_y + extent_y - 0.5, height - 1.0)
    seen = seen & (right >= left) & (bottom >= top)

    store(staged, _X * GROUP, mean_x)
    store(staged, _Y * GROUP, mean_y)
    store(staged, _X_PER_Y * GROUP, x_per_y)
    store(staged, _INV_STD_X * GROUP, inv_std_x * UNIT)
    store(staged, _INV_STD_Y * GROUP, inv_std_y * UNIT)
    store(staged, _Y_PER_X * GROUP, x_per_y * variance_y / variance_x)
    store(staged, _LOG_OPACITY * GROUP, log_opacity)
    store(staged, _CUTOFF * GROUP, cutoff)
    store(staged, _DEPTH * GROUP, z)
    store(staged, _LEFT * GROUP, left)
    store(staged, _TOP * GROUP, top)
    store(staged, _RIGHT * GROUP, right)
    store(staged, _BOTTOM * GROUP, bottom)
    shorten = 1.0 / square_root(dx * dx + dy * dy + dz * dz)
    store(staged, _DIRECTION_X * GROUP, dx * shorten)
    store(staged, _DIRECTION_Y * GROUP, dy * shorten)
    store(staged, _DIRECTION_Z * GROUP, dz * shorten)
    return mask_bits(seen), mask_bits(finite)


@inlined
def _all_finite(harmonics, i, count):
    total = 0.0  # float32 cannot overflow a float64 sum
    for k in range(U(3) * count * i, U(3) * count * (i + U(1))):
        total += np.float64(harmonics[k])
    return math.isfinite(total)


@inlined
def _write_box(boxes, i, results, lane):
    """Write the first and last tile; first > last when no pixel centre lies between the bounds."""
    left = math.ceil(results[_LEFT * GROUP + lane])
    top = math.ceil(results[_TOP * GROUP + lane])
    right = math.floor(results[_RIGHT * GROUP + lane])
    bottom = math.floor(results[_BOTTOM * GROUP + lane])
    if left > right or top > bottom:
        _write_box_of(boxes, i, 1, 1, 0, 0)
        return
    tile = U(layout.TILE)
    first_column, last_column = U(left) // tile, U(right) // tile
    _write_box_of(
        boxes, i, first_column, U(top) // tile, last_column, U(bottom) // tile
    )


@inlined
def _write_box_of(boxes, i, left, top, right, bottom):
    place = U(4) * i
    boxes[place], boxes[place + U(1)] = left, top
    boxes[place + U(2)], boxes[place + U(3)] = right, bottom


@inlined
def _write_geometry(records, i, results, lane):
    record = i * U(layout.RECORD)
    x = results[_X * GROUP + lane]
    y = results[_Y * GROUP + lane]
    x_per_y = results[_X_PER_Y * GROUP + lane]
    records[record + layout.X], records[record + layout.Y] = x, y
    records[record + layout.X_PER_Y] = x_per_y
    records[record + layout.X_REST] = x - np.float64(np.float32(x))
    records[record + layout.Y_REST] = y - np.float64(np.float32(y))
    records[record + layout.X_PER_Y_REST] = x_per_y - np.float64(np.float32(x_per_y))
    records[record + layout.INV_STD_X] = results[_INV_STD_X * GROUP + lane]
    records[record + layout.INV_STD_Y] = results[_INV_STD_Y * GROUP + lane]
    records[record + layout.LOG_OPACITY] = results[_LOG_OPACITY * GROUP + lane]
    records[record + layout.Y_PER_X] = results[_Y_PER_X * GROUP + lane]
    records[record + layout.CUTOFF] = results[_CUTOFF * GROUP + lane]
    records[record + layout.DEPTH] = results[_DEPTH * GROUP + lane]


@inlined
def _write_colour(records, i, results, lane, harmonics, count):
    """Write the colour seen from the camera; returns whether the harmonics are finite."""
    record, first = i * U(layout.RECORD), U(3) * count * i
    red = DC * np.float64(harmonics[first])
    green = DC * np.float64(harmonics[first + U(1)])
    blue = DC * np.float64(harmonics[first + U(2)])
    if count > U(1):
        east = results[_DIRECTION_X * GROUP + lane]
        down = results[_DIRECTION_Y * GROUP + lane]
        ahead = results[_DIRECTION_Z * GROUP + lane]
        basis = shifted(results, _BASIS * GROUP)
        evaluate_basis(east, down, ahead, count, basis)
        for k in range(U(1), count):
            red += basis[k] * np.float64(harmonics[first + U(3) * k])
            green += basis[k] * np.float64(harmonics[first + U(3) * k + U(1)])
            blue += basis[k] * np.float64(harmonics[first + U(3) * k + U(2)])
    records[record + layout.RED] = min(max(red + 0.5, 0.0), MAX_COLOUR)
    records[record + layout.GREEN] = min(max(green + 0.5, 0.0), MAX_COLOUR)
    records[record + layout.BLUE] = min(max(blue + 0.5, 0.0), MAX_COLOUR)
    return math.isfinite(red + green + blue)
