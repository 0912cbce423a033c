"""sRGB to light and back, and to CIE Lab.

Written here because kornia, which has them too, takes a quarter of a second to import.
"""

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
    """CIE Lab of sRGB in [0, 1], for the white D65."""
    to_xyz = images.new_tensor(_TO_XYZ)
    xyz = torch.einsum("oi,...ihw->...ohw", to_xyz, srgb_to_linear(images))
    xyz = xyz / images.new_tensor(_WHITE)[:, None, None]
    x, y, z = torch.where(xyz > 0.008856, xyz.pow(1 / 3), 7.787 * xyz + 4 / 29).unbind(
        -3
    )
    return torch.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), -3)


def srgb_to_linear(images: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """Light that sRGB in [0, 1] stands for."""
    return torch.where(
        images > 0.04045, ((images + 0.055) / 1.055).pow(2.4), images / 12.92
    )


def linear_to_srgb(linear: Float[Tensor, "*shape"]) -> Float[Tensor, "*shape"]:
    """sRGB in [0, 1] that stands for light, the inverse of `srgb_to_linear`."""
    return torch.where(
        linear > 0.0031308, 1.055 * linear.pow(1 / 2.4) - 0.055, 12.92 * linear
    ).clamp(0, 1)
