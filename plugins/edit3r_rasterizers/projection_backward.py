"""Turn a splat's sums over its pixels into gradients of its Gaussian, eight at a time, in
float64.
"""

import math

import numpy as np

from edit3r.contract.types import DC
from edit3r_rasterizers import layout, projection_maths as maths
from edit3r_rasterizers.kernels import inlined, kernel
from edit3r_rasterizers.projection import UNIT
from edit3r_rasterizers.projection_maths import GROUP, INPUTS, OPACITY, U, staged_row
from edit3r_rasterizers.settings import MAX_COLOUR
from edit3r_rasterizers.sh_kernels import basis_gradient, evaluate_basis
from edit3r_rasterizers.simd import select
from edit3r_rasterizers.simd_memory import add, flat, prefetch, shifted, store

F = np.float32
_PER_UNIT = 1.0 / UNIT
_AHEAD = U(layout.LOOKAHEAD)
_MEAN, _SCALE, _QUAT, _OPACITY = INPUTS, INPUTS + U(3), INPUTS + U(6), INPUTS + U(10)
_TOTALS = INPUTS + U(11)
_BASIS = _TOTALS + U(layout.SUMS)
_WEIGHTS = _BASIS + U(4)
"""Rows of the scratch memory after the staged inputs, one lane per Gaussian: gradients, then sums
over pixels. The last two hold one direction's harmonics basis, and the gradient by it.
"""
PROJECTION_BACKWARD_SCRATCH = int((_WEIGHTS + U(4)) * GROUP)
"""Doubles of scratch memory that `project_backward` needs."""


@kernel
def project_backward(
    first,
    last,
    gaussians,
    camera,
    eps2d,
    records,
    entries,
    sums,
    shapes,
    scratch,
    group,
    camera_sums,
    gradients,
):
    """Add the gradients of the Gaussians [first, last) for one camera to the five arrays
    `gradients`.

    Without `shapes` only those by the harmonics, as colours. `entries` are splat_offsets and
    positions: `positions[splat_offsets[i] : splat_offsets[i + 1]]` are the rows of `sums` that
    belong to Gaussian i. `scratch` and `group` (eight indices): work space.

    To `camera_sums` [POSE, GROUP], which are returned, are added the gradients by the camera in
    eight parts; for None another kernel is compiled, that does not know of them.
    """
    by_pose = flat(camera_sums)
    count = U(gaussians.harmonics.shape[1])
    gaussians, gradients = flat(gaussians), flat(gradients)
    camera, records, sums = flat((camera, records, sums))
    splat_offsets, positions = flat(entries)
    scratch, group = flat((scratch, group))
    touched = U(0)
    for i in range(U(first), U(last)):
        start, end = splat_offsets[i], splat_offsets[i + U(1)]
        if start < end:
            group[touched] = i
            maths.stage(scratch, touched, i, gaussians)
            _add_up(scratch, touched, start, end, positions, sums)
            touched += U(1)
        if touched == GROUP or (i + U(1) == U(last) and touched > U(0)):
            # lanes of a short group hold some sound Gaussian that no pixel shows
            for lane in range(touched, GROUP):
                maths.stage(scratch, lane, group[U(0)], gaussians)
                _add_up(scratch, lane, 0, 0, positions, sums)
            if shapes:
                _differentiate_group(scratch, camera, eps2d, by_pose)
            for lane in range(touched):
                k = group[lane]
                if shapes:
                    _take(gradients.means, k, U(3), scratch, _MEAN, lane)
                    _take(gradients.scales, k, U(3), scratch, _SCALE, lane)
                    _take(gradients.quats, k, U(4), scratch, _QUAT, lane)
                    _take(gradients.opacities, k, U(1), scratch, _OPACITY, lane)
                seen = records, camera, gaussians.means, gaussians.harmonics
                _differentiate_colour(k, lane, count, scratch, seen, gradients, by_pose)
            touched = U(0)
    return camera_sums


@inlined
def _take(gradients, k, columns, staged, row, lane):
    """Add one lane of the staged results to the gradients of Gaussian `k`."""
    for axis in range(columns):
        gradients[columns * k + axis] += staged[(row + axis) * GROUP + lane]


@inlined
def _add_up(totals, lane, start, end, positions, sums):
    """Sum a splat's rows of `sums`, in the order of its tiles, into one lane."""
    for k in range(U(layout.SUMS)):
        totals[(_TOTALS + k) * GROUP + lane] = 0.0
    for place in range(U(start), U(end)):
        prefetch(sums, U(positions[place + _AHEAD]) * U(layout.SUMS))
        row = U(positions[place]) * U(layout.SUMS)
        for k in range(U(layout.SUMS)):
            totals[(_TOTALS + k) * GROUP + lane] += np.float64(sums[row + k])


@inlined
def _differentiate_group(staged, camera, eps2d, by_pose):
    """Gradients of eight Gaussians' geometry, by the chain rule through projection."""
    dx, dy, dz = maths.offset_from_camera(staged, camera)
    x, y, z = maths.camera_position(camera, dx, dy, dz)
    per_z = 1.0 / z
    u, v = x * per_z, y * per_z
    a, b, c, d, inverse = maths.unit_quats(staged)
    rotation = maths.rotation_matrix(a, b, c, d)
    rows = maths.image_rows(camera, u, v, per_z)
    j0, j1, j2, k0, k1, k2 = rows
    s0, s1, s2 = maths.staged_scales(staged)
    # Rows of the covariance's factor J R diag(s): before scaling m and n, after it a and b.
    m0, m1, m2, n0, n1, n2 = maths.jacobian_rotation_rows(rows, rotation)
    a0, a1, a2, b0, b1, b2 = m0 * s0, m1 * s1, m2 * s2, n0 * s0, n1 * s1, n2 * s2
    x_per_y, inv_std_x, inv_std_y, _, _ = maths.factorised_conic(
        a0, a1, a2, b0, b1, b2, eps2d
    )

    # With the whitening W of the 2D offset, d loss / d [a; b] = W^T M W [a; b], M the whitened
    # second moments.
    ss = staged_row(staged, _TOTALS + layout.SUM_VSS) * (_PER_UNIT * _PER_UNIT)
    st = staged_row(staged, _TOTALS + layout.SUM_VST) * (_PER_UNIT * _PER_UNIT)
    tt = staged_row(staged, _TOTALS + layout.SUM_VTT) * (_PER_UNIT * _PER_UNIT)
    p0 = inv_std_x * (a0 - x_per_y * b0)
    p1 = inv_std_x * (a1 - x_per_y * b1)
    p2 = inv_std_x * (a2 - x_per_y * b2)
    q0, q1, q2 = inv_std_y * b0, inv_std_y * b1, inv_std_y * b2
    f0 = inv_std_x * (ss * p0 + st * q0)
    f1 = inv_std_x * (ss * p1 + st * q1)
    f2 = inv_std_x * (ss * p2 + st * q2)
    g0 = inv_std_y * (st * p0 + tt * q0) - x_per_y * f0
    g1 = inv_std_y * (st * p1 + tt * q1) - x_per_y * f1
    g2 = inv_std_y * (st * p2 + tt * q2) - x_per_y * f2
    store(staged, _SCALE * GROUP, f0 * m0 + g0 * n0)
    store(staged, (_SCALE + U(1)) * GROUP, f1 * m1 + g1 * n1)
    store(staged, (_SCALE + U(2)) * GROUP, f2 * m2 + g2 * n2)
    f0, f1, f2, g0, g1, g2 = f0 * s0, f1 * s1, f2 * s2, g0 * s0, g1 * s1, g2 * s2

    # by the rotation matrix
    h0, h1, h2 = j0 * f0 + k0 * g0, j0 * f1 + k0 * g1, j0 * f2 + k0 * g2
    h3, h4, h5 = j1 * f0 + k1 * g0, j1 * f1 + k1 * g1, j1 * f2 + k1 * g2
    h6, h7, h8 = j2 * f0 + k2 * g0, j2 * f1 + k2 * g1, j2 * f2 + k2 * g2
    _store_quat_gradients(
        staged, (a, b, c, d), inverse, (h0, h1, h2, h3, h4, h5, h6, h7, h8)
    )

    # By the rows of the Jacobian in world axes, and through its tangents and 1 / z.
    f0, f1, f2 = _turned(rotation, f0, f1, f2)
    g0, g1, g2 = _turned(rotation, g0, g1, g2)
    by_x = inv_std_x * staged_row(staged, _TOTALS + layout.SUM_VS) * _PER_UNIT
    by_y = (
        inv_std_y * staged_row(staged, _TOTALS + layout.SUM_VT) * _PER_UNIT
        - x_per_y * by_x
    )
    by_u, by_v = by_x * camera[layout.FOCAL_X], by_y * camera[layout.FOCAL_Y]
    inside_x = (u >= camera[layout.LOW_X]) & (u <= camera[layout.HIGH_X])
    inside_y = (v >= camera[layout.LOW_Y]) & (v <= camera[layout.HIGH_Y])
    along_f = f0 * camera[2] + f1 * camera[5] + f2 * camera[8]
    along_g = g0 * camera[2] + g1 * camera[5] + g2 * camera[8]
    tilt_u = by_u - select(inside_x, along_f * per_z * camera[layout.FOCAL_X], 0.0)
    tilt_v = by_v - select(inside_y, along_g * per_z * camera[layout.FOCAL_Y], 0.0)
    jacobian = j0 * f0 + j1 * f1 + j2 * f2 + k0 * g0 + k1 * g1 + k2 * g2
    gx, gy = tilt_u * per_z, tilt_v * per_z
    gz = (
        staged_row(staged, _TOTALS + layout.SUM_DEPTH)
        - (tilt_u * u + tilt_v * v + jacobian) * per_z
    )
    for axis in range(U(3)):
        world = (
            gx * camera[U(3) * axis]
            + gy * camera[U(3) * axis + U(1)]
            + gz * camera[U(3) * axis + U(2)]
        )
        store(staged, (_MEAN + axis) * GROUP, world)
    store(
        staged,
        _OPACITY * GROUP,
        staged_row(staged, _TOTALS + layout.SUM_V) / staged_row(staged, OPACITY),
    )
    if by_pose is not None:
        # The rows of the Jacobian are the rotation times FOCAL_X / z * (1, 0, -u) and
        # FOCAL_Y / z * (0, 1, -v), u and v clamped.
        focal_x, focal_y = camera[layout.FOCAL_X], camera[layout.FOCAL_Y]
        f0, f1, f2 = f0 * per_z * focal_x, f1 * per_z * focal_x, f2 * per_z * focal_x
        g0, g1, g2 = g0 * per_z * focal_y, g1 * per_z * focal_y, g2 * per_z * focal_y
        fx, _, fz = maths.camera_position(camera, f0, f1, f2)
        _, hy, hz = maths.camera_position(camera, g0, g1, g2)
        add(by_pose, U(layout.FOCAL_X) * GROUP, (tilt_u * u + fx) / focal_x)
        add(by_pose, U(layout.FOCAL_Y) * GROUP, (tilt_v * v + hy) / focal_y)
        add(by_pose, U(layout.CENTRE_X) * GROUP, (tilt_u + fz) / focal_x)
        add(by_pose, U(layout.CENTRE_Y) * GROUP, (tilt_v + hz) / focal_y)
        u, v = maths.clamped_tangents(camera, u, v)
        _add_axis(staged, by_pose, 0, gx, gy, gz, dx, f0, g0, u, v)
        _add_axis(staged, by_pose, 1, gx, gy, gz, dy, f1, g1, u, v)
        _add_axis(staged, by_pose, 2, gx, gy, gz, dz, f2, g2, u, v)


@inlined
def _turned(rotation, f0, f1, f2):
    """The rotation matrix times a vector."""
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = rotation
    return (
        f0 * r0 + f1 * r1 + f2 * r2,
        f0 * r3 + f1 * r4 + f2 * r5,
        f0 * r6 + f1 * r7 + f2 * r8,
    )


@inlined
def _add_axis(staged, by_pose, axis, gx, gy, gz, offset, f, g, u, v):
    """Add the gradients by one row of the rotation, and by one coordinate of the centre."""
    add(by_pose, U(3 * axis) * GROUP, offset * gx + f)
    add(by_pose, U(3 * axis + 1) * GROUP, offset * gy + g)
    add(by_pose, U(3 * axis + 2) * GROUP, offset * gz - f * u - g * v)
    add(
        by_pose,
        U(layout.CENTRE + axis) * GROUP,
        0.0 - staged_row(staged, _MEAN + U(axis)),
    )


@inlined
def _store_quat_gradients(staged, quat, inverse, by_rotation):
    """From the rotation matrix to a quaternion of any norm; zero for the identity's."""
    a, b, c, d = quat
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = by_rotation
    ga = 2.0 * (d * (h3 - h1) + c * (h2 - h6) + b * (h7 - h5))
    gb = 2.0 * (c * (h1 + h3) + d * (h2 + h6) + a * (h7 - h5) - 2.0 * b * (h4 + h8))
    gc = 2.0 * (b * (h1 + h3) + d * (h5 + h7) + a * (h2 - h6) - 2.0 * c * (h0 + h8))
    gd = 2.0 * (b * (h2 + h6) + c * (h5 + h7) + a * (h3 - h1) - 2.0 * d * (h0 + h4))
    along = ga * a + gb * b + gc * c + gd * d
    store(staged, _QUAT * GROUP, (ga - along * a) * inverse)
    store(staged, (_QUAT + U(1)) * GROUP, (gb - along * b) * inverse)
    store(staged, (_QUAT + U(2)) * GROUP, (gc - along * c) * inverse)
    store(staged, (_QUAT + U(3)) * GROUP, (gd - along * d) * inverse)


@inlined
def _differentiate_colour(i, lane, count, scratch, seen, gradients, by_pose):
    """Add the gradients by the harmonics, and by mean and camera through the direction `seen`:
    records, camera, means and harmonics.
    """
    records, camera, means, harmonics = seen
    mean_gradients, harmonic_gradients = gradients.means, gradients.harmonics
    record, first = i * U(layout.RECORD), U(3) * count * i
    by_red = scratch[(_TOTALS + layout.SUM_RED) * GROUP + lane]
    by_green = scratch[(_TOTALS + layout.SUM_GREEN) * GROUP + lane]
    by_blue = scratch[(_TOTALS + layout.SUM_BLUE) * GROUP + lane]
    red = _unless_clamped(records[record + layout.RED], by_red)
    green = _unless_clamped(records[record + layout.GREEN], by_green)
    blue = _unless_clamped(records[record + layout.BLUE], by_blue)
    harmonic_gradients[first] += DC * red
    harmonic_gradients[first + U(1)] += DC * green
    harmonic_gradients[first + U(2)] += DC * blue
    if count == U(1):
        return
    dx = np.float64(means[U(3) * i]) - camera[layout.CENTRE]
    dy = np.float64(means[U(3) * i + U(1)]) - camera[layout.CENTRE + 1]
    dz = np.float64(means[U(3) * i + U(2)]) - camera[layout.CENTRE + 2]
    shorten = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    x, y, z = dx * shorten, dy * shorten, dz * shorten
    basis = shifted(scratch, _BASIS * GROUP)
    weights = shifted(scratch, _WEIGHTS * GROUP)
    evaluate_basis(x, y, z, count, basis)
    for k in range(U(1), count):
        place = first + U(3) * k
        harmonic_gradients[place] += basis[k] * red
        harmonic_gradients[place + U(1)] += basis[k] * green
        harmonic_gradients[place + U(2)] += basis[k] * blue
        of_red, of_green = np.float64(harmonics[place]), harmonics[place + U(1)]
        weight = red * of_red + green * np.float64(of_green)
        weights[k] = weight + blue * np.float64(harmonics[place + U(2)])
    gx, gy, gz = basis_gradient(x, y, z, weights, count)
    along = gx * x + gy * y + gz * z
    gx = (gx - along * x) * shorten
    gy = (gy - along * y) * shorten
    gz = (gz - along * z) * shorten
    mean_gradients[U(3) * i] += gx
    mean_gradients[U(3) * i + U(1)] += gy
    mean_gradients[U(3) * i + U(2)] += gz
    if by_pose is not None:
        by_centre = shifted(by_pose, U(layout.CENTRE) * GROUP)
        by_centre[lane] -= gx
        by_centre[GROUP + lane] -= gy
        by_centre[U(2) * GROUP + lane] -= gz


@inlined
def _unless_clamped(colour, gradient):
    return gradient if 0.0 < colour < MAX_COLOUR else 0.0
