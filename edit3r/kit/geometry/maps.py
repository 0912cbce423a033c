"""Maps of pixels: dilation, blending by masks, and resizing."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.kit.compute.layers import bilinear

__all__ = [
    "composite",
    "dilate",
    "dilate_softly",
    "feathered",
    "resampled",
    "resize",
    "size_of",
]

# of `dilate_softly` [longer sides]: an edit needs room at the edge of its mask; no figure kept
MARGIN = 0.01


def size_of(maps: Float[Tensor, "*batch height width"]) -> tuple[int, int]:
    """(height, width) of images or maps [pixels]."""
    height, width = maps.shape[-2:]
    return height, width


def dilate(
    maps: Float[Tensor, "*batch height width"], radius: int
) -> Float[Tensor, "*batch height width"]:
    """The largest value in the square of `radius` pixels around each pixel; differentiable.

    Pixels outside the image do not count. The erosion of a map is `-dilate(-maps, radius)`.
    """
    widest = maps.reshape(-1, 1, *maps.shape[-2:])
    # columns, rows
    for kernel, padding in (
        ((2 * radius + 1, 1), (radius, 0)),
        ((1, 2 * radius + 1), (0, radius)),
    ):
        widest = F.max_pool2d(widest, kernel, stride=1, padding=padding)
    return widest.reshape(maps.shape)


def dilate_softly(
    masks: Float[Tensor, "view height width"],
) -> Float[Tensor, "view height width"]:
    """0/1 masks with a soft margin outside: 1 on the object, 0 beyond the margin, exactly."""
    radius = max(1, round(MARGIN * max(masks.shape[-2:])))
    wide = dilate(masks, radius)[:, None]
    soft = F.avg_pool2d(
        wide, 2 * radius + 1, stride=1, padding=radius, count_include_pad=False
    )[:, 0]
    return torch.maximum(masks, soft)


def feathered(
    masks: Float[Tensor, "*batch height width"], pixels: float
) -> Float[Tensor, "*batch height width"]:
    """Weights that rise from 0 at the outline of each mask (values above 0.5) to 1 `pixels` inside
    it, and are 0 outside; the border of the image is no outline.
    """
    inside = (masks.reshape(-1, *masks.shape[-2:]) > 0.5).numpy(force=True)
    depths = np.zeros(inside.shape, np.float32)
    for weight, mask in zip(depths, inside):
        if mask.all():
            weight[:] = 1
        elif mask.any():
            weight[:] = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
            weight /= pixels
    share = torch.from_numpy(depths.clip(0, 1)).to(masks).reshape(masks.shape)
    return share * share * (3 - 2 * share)


def composite(
    original: Float[Tensor, "batch view 3 height width"],
    edited: Float[Tensor, "batch view 3 height width"],
    masks: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 3 height width"]:
    """Blend by mask; bit-equal to `original` where the mask is 0 and to `edited` where it is 1."""
    weight = masks[:, :, None]
    blended = original + weight * (edited - original)
    return torch.where(weight <= 0, original, torch.where(weight >= 1, edited, blended))


def resize(
    images: Float[Tensor, "*batch channel height width"], size: tuple[int, int]
) -> Float[Tensor, "*batch channel height2 width2"]:
    """Images at `size` (height, width): area mean when they shrink, bilinear when they grow."""
    if tuple(images.shape[-2:]) == size:
        return images
    flat = images.flatten(0, -4)
    shrinks = size[0] <= images.shape[-2]
    return (
        F.interpolate(flat, size, mode="area") if shrinks else bilinear(flat, size)
    ).unflatten(0, images.shape[:-3])


def resampled(
    images: Float[Tensor, "*batch channel height width"], size: tuple[int, int]
) -> Float[Tensor, "*batch channel height2 width2"]:
    """Images in [0, 1] at `size` (height, width), bicubic without aliasing; the same tensor where
    that is their size.
    """
    if tuple(images.shape[-2:]) == tuple(size):
        return images
    flat = images.flatten(0, -4)
    sized = F.interpolate(flat, size, mode="bicubic", antialias=True).clamp(0, 1)
    return sized.unflatten(0, images.shape[:-3])
