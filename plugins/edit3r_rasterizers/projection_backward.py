"""From a splat's sums over its pixels to gradients of the Gaussian it came from, in float64."""

import math

import numpy as np
from numba import njit

from edit3r_rasterizers.projection import (
    _HALF_LOG2E_ROOT,
    camera_position,
    conditional_form,
    image_rows,
    rotation,
)
from edit3r_rasterizers.records import (
    BLUE,
    CENTRE,
    FOCAL_X,
    FOCAL_Y,
    GREEN,
    HIGH_X,
    HIGH_Y,
    LOW_X,
    LOW_Y,
    RED,
    SUM_BLUE,
    SUM_DEPTH,
    SUM_GREEN,
    SUM_RED,
    SUM_V,
    SUM_VS,
    SUM_VSS,
    SUM_VST,
    SUM_VT,
    SUM_VTT,
    SUMS,
)
from edit3r_rasterizers.settings import MAX_COLOUR
from edit3r_rasterizers.sh_kernels import basis_gradient, evaluate_basis

_UNIT = 1.0 / _HALF_LOG2E_ROOT  # from the records' base-2 units to standard deviations


@njit(cache=True, error_model="numpy", nogil=True)
def project_backward(
    first,
    last,
    means,
    scales,
    quats,
    opacities,
    harmonics,
    camera,
    eps2d,
    records,
    places,
    positions,
    sums,
    mean_gradients,
    scale_gradients,
    quat_gradients,
    opacity_gradients,
    harmonic_gradients,
):
    """Add the gradients of the Gaussians [first, last) for one camera to the five gradient arrays.

    `positions[places[i, 0] : places[i, 1]]` are the rows of `sums` that belong to Gaussian i.
    """
    count = harmonics.shape[1]
    basis, weights, total = np.empty(25), np.empty(25), np.empty(SUMS)
    for i in range(np.uint64(first), np.uint64(last)):
        if places[i, 0] == places[i, 1]:
            continue
        total[:] = 0
        for place in range(np.uint64(places[i, 0]), np.uint64(places[i, 1])):
            row = np.uint64(positions[place])
            for k in range(np.uint64(SUMS)):
                total[k] += np.float64(sums[row, k])
        dx = np.float64(means[i, 0]) - camera[CENTRE]
        dy = np.float64(means[i, 1]) - camera[CENTRE + 1]
        dz = np.float64(means[i, 2]) - camera[CENTRE + 2]
        s0, s1, s2 = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
        qa, qb = np.float64(quats[i, 0]), np.float64(quats[i, 1])
        qc, qd = np.float64(quats[i, 2]), np.float64(quats[i, 3])
        x, y, z = camera_position(camera, dx, dy, dz)
        u, v = x / z, y / z
        r0, r1, r2, r3, r4, r5, r6, r7, r8, inverse = rotation(qa, qb, qc, qd)
        j0, j1, j2, k0, k1, k2 = image_rows(camera, u, v, z)
        # Rows of the 2D factor before scaling (J R), and after.
        m0, n0 = j0 * r0 + j1 * r3 + j2 * r6, k0 * r0 + k1 * r3 + k2 * r6
        m1, n1 = j0 * r1 + j1 * r4 + j2 * r7, k0 * r1 + k1 * r4 + k2 * r7
        m2, n2 = j0 * r2 + j1 * r5 + j2 * r8, k0 * r2 + k1 * r5 + k2 * r8
        a0, a1, a2, b0, b1, b2 = m0 * s0, m1 * s1, m2 * s2, n0 * s0, n1 * s1, n2 * s2
        slope, narrowness, flatness, _, _ = conditional_form(a0, a1, a2, b0, b1, b2, eps2d)

        # d loss / d rows: with whitened rows p, q it is W^T M [p; q], M the second moments of the whitened offsets.
        vs, vt = total[SUM_VS] * _UNIT, total[SUM_VT] * _UNIT
        ss, st, tt = total[SUM_VSS] * _UNIT**2, total[SUM_VST] * _UNIT**2, total[SUM_VTT] * _UNIT**2
        p0, p1, p2 = narrowness * (a0 - slope * b0), narrowness * (a1 - slope * b1), narrowness * (a2 - slope * b2)
        q0, q1, q2 = flatness * b0, flatness * b1, flatness * b2
        c0 = narrowness * (ss * p0 + st * q0)
        c1 = narrowness * (ss * p1 + st * q1)
        c2 = narrowness * (ss * p2 + st * q2)
        d0 = flatness * (st * p0 + tt * q0) - slope * c0
        d1 = flatness * (st * p1 + tt * q1) - slope * c1
        d2 = flatness * (st * p2 + tt * q2) - slope * c2
        scale_gradients[i, 0] += c0 * m0 + d0 * n0
        scale_gradients[i, 1] += c1 * m1 + d1 * n1
        scale_gradients[i, 2] += c2 * m2 + d2 * n2
        c0, c1, c2, d0, d1, d2 = c0 * s0, c1 * s1, c2 * s2, d0 * s0, d1 * s1, d2 * s2

        if inverse > 0.0:
            g0, g1, g2 = j0 * c0 + k0 * d0, j0 * c1 + k0 * d1, j0 * c2 + k0 * d2  # by the rotation matrix
            g3, g4, g5 = j1 * c0 + k1 * d0, j1 * c1 + k1 * d1, j1 * c2 + k1 * d2
            g6, g7, g8 = j2 * c0 + k2 * d0, j2 * c1 + k2 * d1, j2 * c2 + k2 * d2
            a, b, c, d = qa * inverse, qb * inverse, qc * inverse, qd * inverse
            ga = 2.0 * (d * (g3 - g1) + c * (g2 - g6) + b * (g7 - g5))
            gb = 2.0 * (c * (g1 + g3) + d * (g2 + g6) + a * (g7 - g5) - 2.0 * b * (g4 + g8))
            gc = 2.0 * (b * (g1 + g3) + d * (g5 + g7) + a * (g2 - g6) - 2.0 * c * (g0 + g8))
            gd = 2.0 * (b * (g2 + g6) + c * (g5 + g7) + a * (g3 - g1) - 2.0 * d * (g0 + g4))
            along = ga * a + gb * b + gc * c + gd * d
            quat_gradients[i, 0] += (ga - along * a) * inverse
            quat_gradients[i, 1] += (gb - along * b) * inverse
            quat_gradients[i, 2] += (gc - along * c) * inverse
            quat_gradients[i, 3] += (gd - along * d) * inverse

        # By the Jacobian's rows in camera axes, then by the camera position.
        f0 = c0 * r0 + c1 * r1 + c2 * r2
        f1 = c0 * r3 + c1 * r4 + c2 * r5
        f2 = c0 * r6 + c1 * r7 + c2 * r8
        h0 = d0 * r0 + d1 * r1 + d2 * r2
        h1 = d0 * r3 + d1 * r4 + d2 * r5
        h2 = d0 * r6 + d1 * r7 + d2 * r8
        scale_x, scale_y = camera[FOCAL_X] / z, camera[FOCAL_Y] / z
        by_x = narrowness * vs
        by_y = flatness * vt - slope * by_x
        by_u, by_v = camera[FOCAL_X] * by_x, camera[FOCAL_Y] * by_y
        forward_f = camera[2] * f0 + camera[5] * f1 + camera[8] * f2
        forward_h = camera[2] * h0 + camera[5] * h1 + camera[8] * h2
        if camera[LOW_X] <= u <= camera[HIGH_X]:
            by_u -= scale_x * forward_f
        if camera[LOW_Y] <= v <= camera[HIGH_Y]:
            by_v -= scale_y * forward_h
        gx, gy = by_u / z, by_v / z
        gz = -(by_u * u + by_v * v) / z + total[SUM_DEPTH]
        gz -= (j0 * f0 + j1 * f1 + j2 * f2 + k0 * h0 + k1 * h1 + k2 * h2) / z

        opacity_gradients[i] += total[SUM_V] / np.float64(opacities[i])
        record = records[i]
        by_red = total[SUM_RED] if 0.0 < record[RED] < MAX_COLOUR else 0.0
        by_green = total[SUM_GREEN] if 0.0 < record[GREEN] < MAX_COLOUR else 0.0
        by_blue = total[SUM_BLUE] if 0.0 < record[BLUE] < MAX_COLOUR else 0.0
        shorten = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
        ex, ey, ez = dx * shorten, dy * shorten, dz * shorten
        evaluate_basis(ex, ey, ez, count, basis)
        for k in range(np.uint64(count)):
            harmonic_gradients[i, k, 0] += basis[k] * by_red
            harmonic_gradients[i, k, 1] += basis[k] * by_green
            harmonic_gradients[i, k, 2] += basis[k] * by_blue
            weights[k] = by_red * np.float64(harmonics[i, k, 0]) + by_green * np.float64(harmonics[i, k, 1])
            weights[k] += by_blue * np.float64(harmonics[i, k, 2])
        wx, wy, wz = basis_gradient(ex, ey, ez, weights, count)
        along = wx * ex + wy * ey + wz * ez
        mean_gradients[i, 0] += camera[0] * gx + camera[1] * gy + camera[2] * gz + (wx - along * ex) * shorten
        mean_gradients[i, 1] += camera[3] * gx + camera[4] * gy + camera[5] * gz + (wy - along * ey) * shorten
        mean_gradients[i, 2] += camera[6] * gx + camera[7] * gy + camera[8] * gz + (wz - along * ez) * shorten
