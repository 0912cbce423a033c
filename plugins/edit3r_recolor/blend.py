"""Soft blending of recoloured regions with the original (section 3.2, the unnumbered equation)."""

import torch
from jaxtyping import Float
from torch import Tensor

EPSILON = 1e-6


def renormalize(
    masks: Float[Tensor, "region *batch height width"], epsilon: float = EPSILON
) -> Float[Tensor, "region *batch height width"]:
    """Mask weights per pixel that sum to at most one.

    The paper divides by the sum "when regions overlap" and states that a single region is plain alpha blending, so
    a sum below one is left alone: the soft edge of a mask stays soft.
    """
    total = masks.sum(0)
    return torch.where(total > 1, masks / (total + epsilon), masks)


def blend_regions(
    image: Float[Tensor, "*batch 3 height width"],
    recolored: Float[Tensor, "region *batch 3 height width"],
    masks: Float[Tensor, "region *batch height width"],
    epsilon: float = EPSILON,
) -> Float[Tensor, "*batch 3 height width"]:
    """I' = sum_r a_r C_r(I) + (1 - sum_r a_r) I; pixels no mask touches keep their exact value."""
    weights = renormalize(masks, epsilon).unsqueeze(-3)
    return (weights * recolored).sum(0) + (1 - weights.sum(0)) * image
