"""Bring coarse maps to the photo's size along the photo's edges (fast guided filter, He and Sun 2015)."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def guided_upsample(
    maps: Float[Tensor, "batch channel height width"],
    guide: Float[Tensor, "batch 3 height2 width2"],
    radius: int = 1,
    eps: float = 1e-4,
) -> Float[Tensor, "batch channel height2 width2"]:
    """Every map becomes locally linear in the guide's grey value, with coefficients found on the coarse grid.

    Maps already at the guide's size come back unchanged. `radius` [coarse pixels].
    """
    if maps.shape[-2:] == guide.shape[-2:]:
        return maps
    grey = guide.mean(1, keepdim=True)
    coarse = F.interpolate(grey, maps.shape[-2:], mode="area")
    mean_guide, mean_maps = _box(coarse, radius), _box(maps, radius)
    variance = _box(coarse * coarse, radius) - mean_guide**2
    slope = (_box(coarse * maps, radius) - mean_guide * mean_maps) / (variance + eps)
    offset = mean_maps - slope * mean_guide
    slope, offset = (_resize(_box(x, radius), grey) for x in (slope, offset))
    fine = slope * grey + offset
    # A linear extrapolation may leave the range of what it came from.
    low, high = (_resize(pool, grey) for pool in (-_peak(-maps), _peak(maps)))
    return torch.minimum(torch.maximum(fine, low), high)


def _box(x: Tensor, radius: int) -> Tensor:
    return F.avg_pool2d(F.pad(x, (radius,) * 4, mode="replicate"), 2 * radius + 1, stride=1)


def _peak(x: Tensor) -> Tensor:
    return F.max_pool2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), 3, stride=1)


def _resize(x: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(x, like.shape[-2:], mode="bilinear", align_corners=False)
