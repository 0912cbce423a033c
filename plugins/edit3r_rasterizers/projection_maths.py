"""Maths of the projection for eight Gaussians at a time, in float64, shared by the forward and the
backward pass.

Gaussians are staged first: eight of them side by side in scratch memory, one row per number, so
that a row is a vector.
"""

import numpy as np

from edit3r_rasterizers import layout
from edit3r_rasterizers.kernels import inlined
from edit3r_rasterizers.simd import broadcast, maximum, minimum, select, square_root
from edit3r_rasterizers.simd_memory import load

SHORTEST_QUAT = 1e-12
"""A quaternion not longer than this is taken as the identity."""

U = np.uint64
GROUP = U(8)
MEAN, SCALE, QUAT, OPACITY, INPUTS = U(0), U(3), U(6), U(10), U(11)
"""Rows of the staged inputs."""


@inlined
def stage(staged, lane, i, gaussians):
    """Copy the geometry of Gaussian `i` to one lane of the staged inputs."""
    for k in range(U(3)):
        staged[(MEAN + k) * GROUP + lane] = gaussians.means[U(3) * i + k]
        staged[(SCALE + k) * GROUP + lane] = gaussians.scales[U(3) * i + k]
    for k in range(U(4)):
        staged[(QUAT + k) * GROUP + lane] = gaussians.quats[U(4) * i + k]
    staged[OPACITY * GROUP + lane] = gaussians.opacities[i]


@inlined
def staged_row(staged, row):
    """Return the eight lanes of one row."""
    return load(staged, row * GROUP)


@inlined
def offset_from_camera(staged, camera):
    """Offset of the means from the camera's centre, which is exact far from the origin."""
    x = staged_row(staged, MEAN) - camera[layout.CENTRE]
    y = staged_row(staged, MEAN + U(1)) - camera[layout.CENTRE + 1]
    z = staged_row(staged, MEAN + U(2)) - camera[layout.CENTRE + 2]
    return x, y, z


@inlined
def camera_position(camera, dx, dy, dz):
    """Rotate a world offset from the camera's centre to camera coordinates."""
    x = dx * camera[0] + dy * camera[3] + dz * camera[6]
    y = dx * camera[1] + dy * camera[4] + dz * camera[7]
    z = dx * camera[2] + dy * camera[5] + dz * camera[8]
    return x, y, z


@inlined
def clamped_tangents(camera, u, v):
    """Return the tangents at which the Jacobian is taken."""
    u = minimum(maximum(u, camera[layout.LOW_X]), camera[layout.HIGH_X])
    v = minimum(maximum(v, camera[layout.LOW_Y]), camera[layout.HIGH_Y])
    return u, v


@inlined
def image_rows(camera, u, v, per_z):
    """Jacobian of image position by world position [pixels / scene unit], tangents clamped."""
    u, v = clamped_tangents(camera, u, v)
    gx, gy = per_z * camera[layout.FOCAL_X], per_z * camera[layout.FOCAL_Y]
    j0 = (camera[0] - u * camera[2]) * gx
    j1 = (camera[3] - u * camera[5]) * gx
    j2 = (camera[6] - u * camera[8]) * gx
    k0 = (camera[1] - v * camera[2]) * gy
    k1 = (camera[4] - v * camera[5]) * gy
    k2 = (camera[7] - v * camera[8]) * gy
    return j0, j1, j2, k0, k1, k2


@inlined
def unit_quats(staged):
    """Unit quaternions and 1 / norm; identity and 0 for one not longer than SHORTEST_QUAT."""
    a, b = staged_row(staged, QUAT), staged_row(staged, QUAT + U(1))
    c, d = staged_row(staged, QUAT + U(2)), staged_row(staged, QUAT + U(3))
    norm = square_root(a * a + b * b + c * c + d * d)
    sound = norm > SHORTEST_QUAT
    inverse = select(sound, 1.0 / maximum(norm, SHORTEST_QUAT), broadcast(0.0))
    return (
        select(sound, a * inverse, broadcast(1.0)),
        b * inverse,
        c * inverse,
        d * inverse,
        inverse,
    )


@inlined
def staged_scales(staged):
    """Return the three rows of scales."""
    return (
        staged_row(staged, SCALE),
        staged_row(staged, SCALE + U(1)),
        staged_row(staged, SCALE + U(2)),
    )


@inlined
def jacobian_rotation_rows(rows, rotation):
    """Return the rows of J R: the Jacobian's two `rows` times the rotation matrix."""
    j0, j1, j2, k0, k1, k2 = rows
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = rotation
    m0, n0 = j0 * r0 + j1 * r3 + j2 * r6, k0 * r0 + k1 * r3 + k2 * r6
    m1, n1 = j0 * r1 + j1 * r4 + j2 * r7, k0 * r1 + k1 * r4 + k2 * r7
    m2, n2 = j0 * r2 + j1 * r5 + j2 * r8, k0 * r2 + k1 * r5 + k2 * r8
    return m0, m1, m2, n0, n1, n2


@inlined
def rotation_matrix(a, b, c, d):
    """Return the rotation matrix, row-major, of a unit wxyz quaternion."""
    r0 = 1.0 - 2.0 * (c * c + d * d)
    r1 = 2.0 * (b * c - a * d)
    r2 = 2.0 * (b * d + a * c)
    r3 = 2.0 * (b * c + a * d)
    r4 = 1.0 - 2.0 * (b * b + d * d)
    r5 = 2.0 * (c * d - a * b)
    r6 = 2.0 * (b * d - a * c)
    r7 = 2.0 * (c * d + a * b)
    r8 = 1.0 - 2.0 * (b * b + c * c)
    return r0, r1, r2, r3, r4, r5, r6, r7, r8


@inlined
def factorised_conic(a0, a1, a2, b0, b1, b2, eps2d):
    """Factorise the conic of the covariance of rows a (x) and b (y).

    Returns (x_per_y, inv_std_x, inv_std_y, variance_x, variance_y), see `layout`. The variance of x
    given y is det / variance_y, with the determinant as a sum of squares: |a x b|^2 + ...
    """
    square = a0 * a0 + a1 * a1 + a2 * a2
    variance_x, variance_y = square + eps2d, b0 * b0 + b1 * b1 + b2 * b2 + eps2d
    inv_std_y = 1.0 / square_root(variance_y)
    b0, b1, b2 = b0 * inv_std_y, b1 * inv_std_y, b2 * inv_std_y
    e0, e1, e2 = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    given = e0 * e0 + e1 * e1 + e2 * e2 + (square * inv_std_y * inv_std_y + 1.0) * eps2d
    x_per_y = (a0 * b0 + a1 * b1 + a2 * b2) * inv_std_y
    return x_per_y, 1.0 / square_root(given), inv_std_y, variance_x, variance_y
