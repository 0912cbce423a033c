"""Colour spaces: sRGB to CIE Lab and back, without the time that a library takes to load."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

_TO_XYZ = (
    (0.412453, 0.357580, 0.180423),
    (0.212671, 0.715160, 0.072169),
    (0.019334, 0.119193, 0.950227),
)
_WHITE = (0.95047, 1.0, 1.08883)  # D65


def rgb_to_lab(
    images: Float[Tensor, "*batch 3 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """CIE Lab under D65 of sRGB in [0, 1], without the quarter of a second that kornia takes to
    load.
    """
    linear = torch.where(
        images > 0.04045,
        ((images + 0.055) / 1.055).clamp(min=0).pow(2.4),
        images / 12.92,
    )
    xyz = torch.einsum("oi,...ihw->...ohw", images.new_tensor(_TO_XYZ), linear)
    xyz = xyz / images.new_tensor(_WHITE)[:, None, None]
    x, y, z = torch.where(
        xyz > 0.008856, xyz.clamp(min=0.008856).pow(1 / 3), 7.787 * xyz + 4 / 29
    ).unbind(-3)
    return torch.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), -3)


def lab_to_rgb(
    lab: Float[Tensor, "*batch 3 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """The inverse of `rgb_to_lab`, clamped to [0, 1]."""
    lightness, a, b = lab.unbind(-3)
    y = (lightness + 16) / 116
    bent = torch.stack((a / 500 + y, y, (y - b / 200).clamp(min=0)), -3)
    xyz = torch.where(bent > 0.2068966, bent.pow(3), (bent - 4 / 29) / 7.787)
    xyz = xyz * lab.new_tensor(_WHITE)[:, None, None]
    linear = torch.einsum(
        "oi,...ihw->...ohw", lab.new_tensor(np.linalg.inv(_TO_XYZ)), xyz
    )
    return torch.where(
        linear > 0.0031308,
        1.055 * linear.clamp(min=0.0031308).pow(1 / 2.4) - 0.055,
        12.92 * linear,
    ).clamp(0, 1)
