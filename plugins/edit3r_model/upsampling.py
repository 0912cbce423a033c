"""Coarse maps at an image's size, along its edges."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.kit.compute.layers import bilinear


def guided_upsample(
    maps: Float[Tensor, "batch channel height width"],
    guide: Float[Tensor, "batch 3 height2 width2"],
    radius: int = 1,
    eps: float = 1e-4,
) -> Float[Tensor, "batch channel height2 width2"]:
    """Maps at the guide's size, locally linear in its grey value (fast guided filter, 2015).

    The coefficients are found on the coarse grid, in windows of `radius` [coarse pixels]; `eps` is
    the variance of the guide below which it counts as flat. Maps already at the guide's size come
    back unchanged.
    """
    if maps.shape[-2:] == guide.shape[-2:]:
        return maps
    grey = guide.mean(1, keepdim=True)
    coarse = F.interpolate(grey, maps.shape[-2:], mode="area")
    mean_guide, mean_maps = _box(coarse, radius), _box(maps, radius)
    variance = _box(coarse * coarse, radius) - mean_guide**2
    slope = (_box(coarse * maps, radius) - mean_guide * mean_maps) / (variance + eps)
    offset = mean_maps - slope * mean_guide
    slope, offset = (_bilinear(_box(x, radius), grey) for x in (slope, offset))
    fine = slope * grey + offset
    # A linear extrapolation may leave the range of what it came from.
    low, high = (_bilinear(pool, grey) for pool in (-_peak(-maps), _peak(maps)))
    return torch.minimum(torch.maximum(fine, low), high)


def _box(x: Float[Tensor, "b c h w"], radius: int) -> Float[Tensor, "b c h w"]:
    return F.avg_pool2d(
        F.pad(x, (radius,) * 4, mode="replicate"), 2 * radius + 1, stride=1
    )


def _peak(x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b c h w"]:
    return F.max_pool2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), 3, stride=1)


def _bilinear(
    x: Float[Tensor, "b c h w"], like: Float[Tensor, "b d h2 w2"]
) -> Float[Tensor, "b c h2 w2"]:
    height, width = like.shape[-2:]
    return bilinear(x, (height, width))
