"""Real spherical harmonics up to degree 4 in the basis of 3D Gaussian Splatting (Condon-Shortley signs)."""

import torch
from jaxtyping import Float
from torch import Tensor

DC = 0.28209479177387814
"""The constant basis function Y_00; a Gaussian of plain colour c has the harmonic (c - 0.5) / DC."""

_L1 = 0.4886025119029199
_L2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
_L3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)
_L4 = (
    2.5033429417967046,
    -1.7701307697799304,
    0.9461746957575601,
    -0.6690465435572892,
    0.10578554691520431,
    -0.6690465435572892,
    0.47308734787878004,
    -1.7701307697799304,
    0.6258357354491761,
)


def basis(directions: Float[Tensor, "*batch 3"], degree: int) -> Float[Tensor, "*batch coefficient"]:
    """The (degree + 1)^2 basis functions at unit directions."""
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, DC)]
    if degree >= 1:
        values += [-_L1 * y, _L1 * z, -_L1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        xy, yz, xz = x * y, y * z, x * z
        values += [_L2[0] * xy, _L2[1] * yz, _L2[2] * (2 * zz - xx - yy), _L2[3] * xz, _L2[4] * (xx - yy)]
    if degree >= 3:
        values += [
            _L3[0] * y * (3 * xx - yy),
            _L3[1] * xy * z,
            _L3[2] * y * (4 * zz - xx - yy),
            _L3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            _L3[4] * x * (4 * zz - xx - yy),
            _L3[5] * z * (xx - yy),
            _L3[6] * x * (xx - 3 * yy),
        ]
    if degree >= 4:
        values += [
            _L4[0] * xy * (xx - yy),
            _L4[1] * yz * (3 * xx - yy),
            _L4[2] * xy * (7 * zz - 1),
            _L4[3] * yz * (7 * zz - 3),
            _L4[4] * (zz * (35 * zz - 30) + 3),
            _L4[5] * xz * (7 * zz - 3),
            _L4[6] * (xx - yy) * (7 * zz - 1),
            _L4[7] * xz * (xx - 3 * yy),
            _L4[8] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return torch.stack(values, -1)


def colour_to_dc(colours: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Harmonic of degree 0 that shows sRGB `colours` from everywhere."""
    return (colours - 0.5) / DC


def dc_to_colour(dc: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Inverse of `colour_to_dc`, not clipped."""
    return dc * DC + 0.5
