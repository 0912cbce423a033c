"""Dilation of masks and other maps."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

__all__ = ["dilate", "dilate_softly"]

MARGIN = 0.01
"""Width of the margin of `dilate_softly` [longer sides]: an edit needs room at the edge of its mask."""


def dilate(maps: Float[Tensor, "*batch height width"], radius: int) -> Float[Tensor, "*batch height width"]:
    """The largest value in the square of `radius` pixels around each pixel; differentiable.

    Pixels outside the image do not count. The erosion of a map is `-dilate(-maps, radius)`.
    """
    found = maps.reshape(-1, 1, *maps.shape[-2:])
    for kernel, padding in (((2 * radius + 1, 1), (radius, 0)), ((1, 2 * radius + 1), (0, radius))):  # columns, rows
        found = F.max_pool2d(found, kernel, stride=1, padding=padding)
    return found.reshape(maps.shape)


def dilate_softly(masks: Float[Tensor, "view height width"]) -> Float[Tensor, "view height width"]:
    """0/1 masks with a soft margin outside: exactly 1 on the object, exactly 0 beyond the margin."""
    radius = max(1, round(MARGIN * max(masks.shape[-2:])))
    wide = dilate(masks, radius)[:, None]
    soft = F.avg_pool2d(wide, 2 * radius + 1, stride=1, padding=radius, count_include_pad=False)[:, 0]
    return torch.maximum(masks, soft)
