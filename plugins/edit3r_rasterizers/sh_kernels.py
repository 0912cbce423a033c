"""Spherical harmonics of one direction inside numba kernels; basis and signs as in
`edit3r.kit.geometry.harmonics`.
"""

from edit3r.contract.types import DC
from edit3r.kit.geometry.harmonics import C1, C2, C3, C4
from edit3r_rasterizers.kernels import inlined


@inlined
def evaluate_basis(x, y, z, count, out):
    """The first `count` (1, 4, 9, 16 or 25) basis functions of a unit direction, into `out`."""
    out[0] = DC
    if count > 1:
        out[1], out[2], out[3] = -C1 * y, C1 * z, -C1 * x
    if count > 4:
        xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
        out[4], out[5], out[6] = C2[0] * xy, C2[1] * yz, C2[2] * (2 * zz - xx - yy)
        out[7], out[8] = C2[3] * xz, C2[4] * (xx - yy)
        if count > 9:
            out[9] = C3[0] * y * (3 * xx - yy)
            out[10] = C3[1] * xy * z
            out[11] = C3[2] * y * (4 * zz - xx - yy)
            out[12] = C3[3] * z * (2 * zz - 3 * xx - 3 * yy)
            out[13] = C3[4] * x * (4 * zz - xx - yy)
            out[14], out[15] = C3[5] * z * (xx - yy), C3[6] * x * (xx - 3 * yy)
        if count > 16:
            out[16], out[17] = C4[0] * xy * (xx - yy), C4[1] * yz * (3 * xx - yy)
            out[18], out[19] = C4[2] * xy * (7 * zz - 1), C4[3] * yz * (7 * zz - 3)
            out[20] = C4[4] * (zz * (35 * zz - 30) + 3)
            out[21] = C4[5] * xz * (7 * zz - 3)
            out[22] = C4[6] * (xx - yy) * (7 * zz - 1)
            out[23] = C4[7] * xz * (xx - 3 * yy)
            out[24] = C4[8] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy))


@inlined
def basis_gradient(x, y, z, w, count):
    """Return d/dx, d/dy, d/dz of sum_k w[k] * basis_k(x, y, z), the basis taken as polynomials."""
    gx, gy, gz = 0.0, 0.0, 0.0
    if count > 1:
        gx, gy, gz = -C1 * w[3], -C1 * w[1], C1 * w[2]
    if count > 4:
        a = C2[0] * w[4]
        b = C2[1] * w[5]
        c = C2[2] * w[6]
        d = C2[3] * w[7]
        e = C2[4] * w[8]
        gx += a * y - 2 * c * x + d * z + 2 * e * x
        gy += a * x + b * z - 2 * c * y - 2 * e * y
        gz += b * y + 4 * c * z + d * x
    if count > 9:
        dx, dy, dz = _third_order(x, y, z, w)
        gx, gy, gz = gx + dx, gy + dy, gz + dz
    if count > 16:
        dx, dy, dz = _fourth_order(x, y, z, w)
        gx, gy, gz = gx + dx, gy + dy, gz + dz
    return gx, gy, gz


@inlined
def _third_order(x, y, z, w):
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    a, b, c, d = C3[0] * w[9], C3[1] * w[10], C3[2] * w[11], C3[3] * w[12]
    e, f, g = C3[4] * w[13], C3[5] * w[14], C3[6] * w[15]
    planar = 3 * (xx - yy)
    gx = 6 * a * xy + b * yz - 2 * c * xy - 6 * d * xz
    gx += e * (4 * zz - 3 * xx - yy) + 2 * f * xz + g * planar
    gy = a * planar + b * xz + c * (4 * zz - xx - 3 * yy) - 6 * d * yz
    gy += -2 * e * xy - 2 * f * yz - 6 * g * xy
    gz = b * xy + 8 * c * yz + d * (6 * zz - 3 * xx - 3 * yy)
    gz += 8 * e * xz + f * (xx - yy)
    return gx, gy, gz


@inlined
def _fourth_order(x, y, z, w):
    xx, yy, zz, xy = x * x, y * y, z * z, x * y
    a = C4[0] * w[16]
    b = C4[1] * w[17]
    c = C4[2] * w[18]
    d = C4[3] * w[19]
    e = C4[4] * w[20]
    f, g, h, i = C4[5] * w[21], C4[6] * w[22], C4[7] * w[23], C4[8] * w[24]
    seven, third = 7 * zz - 1, 7 * zz - 3
    gx = a * y * (3 * xx - yy) + 6 * b * xy * z + c * y * seven
    gx += f * z * third + 2 * g * x * seven
    gx += 3 * h * z * (xx - yy) + 4 * i * x * (xx - 3 * yy)
    gy = a * x * (xx - 3 * yy) + 3 * b * z * (xx - yy) + c * x * seven
    gy += d * z * third - 2 * g * y * seven
    gy += -6 * h * xy * z + 4 * i * y * (yy - 3 * xx)
    gz = b * y * (3 * xx - yy) + 14 * c * xy * z + d * y * (21 * zz - 3)
    gz += e * z * (140 * zz - 60)
    gz += f * x * (21 * zz - 3) + 14 * g * z * (xx - yy) + h * x * (xx - 3 * yy)
    return gx, gy, gz
