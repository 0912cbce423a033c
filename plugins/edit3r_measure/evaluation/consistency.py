"""Do pictures of one scene agree? Each pixel is carried along its depth into another picture and compared there."""

from collections.abc import Iterable

import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject
from edit3r.types import Cameras

__all__ = ["TOLERANCE", "warped_difference", "warped_picture"]

TOLERANCE = 0.03
"""A carried point whose depth differs from what the other picture sees by more than this share is hidden there."""


def warped_difference(
    images: Float[Tensor, "frame 3 height width"],
    depths: Float[Tensor, "frame height width"],
    cameras: Cameras,
    pairs: Iterable[tuple[int, int]],
    masks: Float[Tensor, "frame height width"] | None = None,
) -> float:
    """Mean absolute difference [sRGB] of pixels that two pictures both see, over `pairs` (from, to) of frames.

    `depths` are camera z, 0 unknown; `cameras` batch 1. With `masks` only pixels of the first picture inside them
    count, weighted. 0 when all agree; never quite 0 in practice, since pixels are interpolated: compare with the
    same measure of the photos. NaN when no pixel is seen twice.
    """
    difference, weight = 0.0, 0.0
    for a, b in pairs:
        carried, seen = warped_picture(images[b], depths[a], depths[b], cameras.select([a, b]))
        counted = seen.to(images.dtype) * (1 if masks is None else masks[a])
        difference += float(((carried - images[a]).abs().mean(0) * counted).sum())
        weight += float(counted.sum())
    return difference / weight if weight > 0 else float("nan")


def warped_picture(
    image: Float[Tensor, "3 height width"],
    depth: Float[Tensor, "height width"],
    depth_there: Float[Tensor, "height width"],
    cameras: Cameras,
) -> tuple[Float[Tensor, "3 height width"], Bool[Tensor, "height width"]]:
    """`image` of the second of two cameras as the first sees it, and where the second sees the same point.

    `depth` is the first camera's, `depth_there` the second's.
    """
    points = unproject(depth, cameras.intrinsics[0, 0], cameras.c2w[0, 0])
    places, z = project(points.reshape(-1, 3), cameras.intrinsics[0, 1], cameras.c2w[0, 1])
    places, z = places.reshape(*depth.shape, 2), z.reshape(depth.shape)
    grid = (2 * places - 1)[None]
    carried = F.grid_sample(image[None], grid, padding_mode="border", align_corners=False)[0]
    there = F.grid_sample(depth_there[None, None], grid, mode="nearest", align_corners=False)[0, 0]
    inside = ((places > 0) & (places < 1)).all(-1)
    seen = inside & (depth > 0) & (z > 0) & (there > 0) & ((z - there).abs() <= TOLERANCE * there)
    return carried, seen
