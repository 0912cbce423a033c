"""sRGB to OKLab and back."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.kit.compute.colour import linear_to_srgb, srgb_to_linear

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
