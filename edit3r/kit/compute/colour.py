"""Colour spaces: sRGB to CIE Lab, and to OKLab and back.

Written here because kornia, which has them too, takes a quarter of a second to import.
"""

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
_TO_CONES = (
    (0.4122214708, 0.5363325363, 0.0514459929),
    (0.2119034982, 0.6806995451, 0.1073969566),
    (0.0883024619, 0.2817188376, 0.6299787005),
)
_TO_OKLAB = (
    (0.2104542553, 0.7936177850, -0.0040720468),
    (1.9779984951, -2.4285922050, 0.4505937099),
    (0.0259040371, 0.7827717662, -0.8086757660),
)


def rgb_to_lab(
    images: Float[Tensor, "*batch 3 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """CIE Lab of sRGB in [0, 1], for the white D65."""
    xyz = _mixed(_TO_XYZ, srgb_to_linear(images))
    xyz = xyz / images.new_tensor(_WHITE)[:, None, None]
    x, y, z = torch.where(xyz > 0.008856, xyz.pow(1 / 3), 7.787 * xyz + 4 / 29).unbind(
        -3
    )
    return torch.stack((116 * y - 16, 500 * (x - y), 200 * (y - z)), -3)


def rgb_to_oklab(
    images: Float[Tensor, "*batch 3 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """OKLab (Ottosson 2020) of sRGB in [0, 1]: lightness in [0, 1], then a and b.

    Shade multiplies all three by the same factor, so the ratio of chroma to lightness stays.
    """
    cones = _mixed(_TO_CONES, srgb_to_linear(images)).clamp(min=0)
    return _mixed(_TO_OKLAB, cones.pow(1 / 3))


def oklab_to_rgb(
    lab: Float[Tensor, "*batch 3 height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """The inverse of `rgb_to_oklab`, clamped to [0, 1]."""
    cones = _mixed(np.linalg.inv(_TO_OKLAB), lab).pow(3)
    return linear_to_srgb(_mixed(np.linalg.inv(_TO_CONES), cones))


def _mixed(
    matrix: tuple | np.ndarray, images: Float[Tensor, "*batch 3 height width"]
) -> Float[Tensor, "*batch 3 height width"]:
    return torch.einsum("oi,...ihw->...ohw", images.new_tensor(matrix), images)


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
