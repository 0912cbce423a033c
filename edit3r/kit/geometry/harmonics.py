"""Real spherical harmonics (SH) up to degree 4 in 3DGS's basis (Condon-Shortley signs)."""

from math import pi, sqrt

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import DC

# Formula of the real harmonics.
# Factors of the functions of degree 1 to 4.
C1 = 0.5 * sqrt(3 / pi)
C2 = tuple(
    a * sqrt(b / pi)
    for a, b in ((0.5, 15), (-0.5, 15), (0.25, 5), (-0.5, 15), (0.25, 15))
)
_OF_3 = ((-0.25, 17.5), (0.5, 105), (-0.25, 10.5), (0.25, 7))
C3 = tuple(a * sqrt(b / pi) for a, b in (*_OF_3, _OF_3[2], (0.25, 105), _OF_3[0]))
_OF_4 = ((12, 35), (-12, 17.5), (12, 5), (-12, 2.5), (3, 1))
C4 = tuple(
    a * sqrt(b / pi) / 16 for a, b in (*_OF_4, _OF_4[3], (6, 5), _OF_4[1], (3, 35))
)


def basis(
    directions: Float[Tensor, "*batch 3"], degree: int
) -> Float[Tensor, "*batch coefficient"]:
    """The (degree + 1)^2 basis functions at unit directions."""
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, DC)]
    if degree >= 1:
        values += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        xy, yz, xz = x * y, y * z, x * z
        values += [
            C2[0] * xy,
            C2[1] * yz,
            C2[2] * (2 * zz - xx - yy),
            C2[3] * xz,
            C2[4] * (xx - yy),
        ]
    if degree >= 3:
        values += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * xy * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    if degree >= 4:
        values += [
            C4[0] * xy * (xx - yy),
            C4[1] * yz * (3 * xx - yy),
            C4[2] * xy * (7 * zz - 1),
            C4[3] * yz * (7 * zz - 3),
            C4[4] * (zz * (35 * zz - 30) + 3),
            C4[5] * xz * (7 * zz - 3),
            C4[6] * (xx - yy) * (7 * zz - 1),
            C4[7] * xz * (xx - 3 * yy),
            C4[8] * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return torch.stack(values, -1)


def colour_to_dc(colours: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Harmonic of degree 0 that shows sRGB `colours` from everywhere."""
    return (colours - 0.5) / DC


def dc_to_colour(dc: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Inverse of `colour_to_dc`, not clipped."""
    return dc * DC + 0.5


def rotate_harmonics(
    harmonics: Float[Tensor, "*batch coefficient 3"], rotation: Float[Tensor, "3 3"]
) -> Float[Tensor, "*batch coefficient 3"]:
    """Harmonics that show in direction R d what the given ones show in d.

    Solved for on more directions than coefficients: B(d) h' = B(R^-1 d) h, where B is the basis.
    """
    degree = round(harmonics.shape[-2] ** 0.5) - 1
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(100, 3, generator=generator, dtype=torch.float64)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    before = basis(directions @ rotation.double(), degree)
    matrix = torch.linalg.pinv(basis(directions, degree)) @ before
    return matrix.to(harmonics) @ harmonics
