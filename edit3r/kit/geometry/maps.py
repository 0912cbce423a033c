"""Maps of pixels: dilation, blending by masks, resizing, and upsampling along an image's edges."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.kit.compute.compiling import compiled
from edit3r.kit.compute.layers import bilinear

__all__ = [
    "composite",
    "dilate",
    "dilate_softly",
    "feathered",
    "guided_upsample",
    "resampled",
    "resize",
    "shown",
    "size_of",
    "upsample_depth",
]

MARGIN = 0.01  # of `dilate_softly` [longer sides]: an edit needs room at the edge of its mask
SAME_COLOUR = 0.1  # colour distance [sRGB] at which a small pixel's weight falls to 1/e
# relative difference in inverse depth within which two pixels lie on one surface
SAME_SURFACE = 0.04


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
    for kernel, padding in (
        ((2 * radius + 1, 1), (radius, 0)),
        ((1, 2 * radius + 1), (0, radius)),
    ):  # columns, rows
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


def guided_upsample(
    maps: Float[Tensor, "batch channel height width"],
    guide: Float[Tensor, "batch 3 height2 width2"],
    radius: int = 1,
    eps: float = 1e-4,
) -> Float[Tensor, "batch channel height2 width2"]:
    """Maps at the guide's size, locally linear in the guide's grey value (fast guided filter, He
    and Sun 2015).

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


def upsample_depth(
    inverse: Float[np.ndarray, "height width"],
    confidence: Float[np.ndarray, "height width"] | Bool[np.ndarray, "height width"],
    guide: Float[np.ndarray, "height width 3"],
    image: Float[np.ndarray, "height2 width2 3"],
) -> tuple[Float[np.ndarray, "height2 width2"], Float[np.ndarray, "height2 width2"]]:
    """Inverse depth and confidence of the small image `guide` for every pixel of the large `image`.

    Each pixel joins the surface of the nearby small pixel that looks most like it, so depth edges
    stay sharp: depths are interpolated within a surface, never across two. Joint bilateral
    upsampling (Kopf et al. 2007) over the four nearest small pixels. Colours in [0, 1]. Not
    differentiable.
    """
    if guide.shape == image.shape:
        return inverse, confidence.astype(np.float32)
    return _joint_upsample(
        inverse,
        confidence.astype(np.float32),
        guide,
        np.ascontiguousarray(image, np.float32),
    )


@compiled(nogil=True)
def _joint_upsample(inverse, measured, guide, photo):  # pragma: no cover - compiled
    small_height, small_width = inverse.shape
    height, width = photo.shape[:2]
    result = np.empty((height, width), np.float32)
    trust = np.empty((height, width), np.float32)
    weights = np.empty(4, np.float32)
    depths = np.empty(4, np.float32)
    trusts = np.empty(4, np.float32)
    for y in range(height):
        place_y = min(
            max((y + 0.5) * small_height / height - 0.5, 0.0), small_height - 1.0
        )
        top = min(int(place_y), max(small_height - 2, 0))
        for x in range(width):
            place_x = min(
                max((x + 0.5) * small_width / width - 0.5, 0.0), small_width - 1.0
            )
            left = min(int(place_x), max(small_width - 2, 0))
            best = 0
            for corner in range(4):
                v = min(top + corner // 2, small_height - 1)
                u = min(left + corner % 2, small_width - 1)
                distance = np.float32(0)
                for channel in range(3):
                    distance += (photo[y, x, channel] - guide[v, u, channel]) ** 2
                near = max(1 - abs(place_y - v), 0.0) * max(1 - abs(place_x - u), 0.0)
                # none alike: then all the same
                likeness = max(np.exp(-distance / SAME_COLOUR**2), 1e-5)
                weights[corner] = (near + 1e-3) * likeness
                depths[corner], trusts[corner] = inverse[v, u], measured[v, u]
                if weights[corner] > weights[best]:
                    best = corner
            total, depth, certain = 1e-12, 0.0, 0.0
            for corner in range(4):
                if abs(depths[corner] - depths[best]) <= SAME_SURFACE * depths[best]:
                    total += weights[corner]
                    depth += weights[corner] * depths[corner]
                    certain += weights[corner] * trusts[corner]
            result[y, x] = depth / total
            trust[y, x] = certain / total
    return result, trust


def shown(masks: Float[Tensor, "view *_ height width"]) -> Tensor:
    """1 for a view where anything is selected, else 0: all but nothing is nothing."""
    return (masks > 0.5).any(-1, keepdim=True).any(-2, keepdim=True).to(masks)
