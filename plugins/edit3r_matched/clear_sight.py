"""What a photo shows must not be hidden: pixels of one view that would cover another view's picture with a colour that
is not there are moved back along their own ray until they do not.

Each photo then still shows what it showed, whatever was wrong with the depth of the others: moving along its ray
changes a pixel's place in every picture but its own.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import invert_rigid, unproject

STEP = 1.05  # depth grows by this factor a step
MOST_STEPS = 60  # 1.05^60 is about 19 times as far
MARGIN = 0.03  # how far before the other view's surface counts as in front of it, relative
DIFFERENT = 0.1  # mean distance of the channels [sRGB] to the colours around the pixel in the other photo


def clear_sight(
    depths: Float[Tensor, "batch view height width"],
    photos: Float[Tensor, "batch view 3 height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    c2w: Float[Tensor, "batch view 4 4"],
) -> Float[Tensor, "batch view height width"]:
    """Depths (camera z) under which no view hides another behind a colour the other does not show. Not differentiable.

    Later views give way first; the first view moves only where the others, once moved, still contradict it.
    """
    depths = depths.clone()
    views = depths.shape[1]
    for view in reversed(range(views)):
        for other in range(views):
            if other != view:
                depths[:, view] = _step_back(depths, photos, intrinsics, c2w, view, other)
    return depths


def _step_back(depths, photos, intrinsics, c2w, view: int, other: int) -> Float[Tensor, "batch height width"]:
    """The depths of `view`, moved back where it covers `other`; where no depth helps they stay as they were."""
    low, high = _colour_range(photos[:, other])
    moved = depths[:, view].clone()
    for _ in range(MOST_STEPS):
        points = unproject(moved, intrinsics[:, view], c2w[:, view])
        covers = _covers(points, photos[:, view], depths[:, other], low, high, intrinsics[:, other], c2w[:, other])
        if not bool(covers.any()):
            return moved
        moved = torch.where(covers, moved * STEP, moved)
    return torch.where(covers, depths[:, view], moved)


def _covers(points, colours, depths, low, high, intrinsics, c2w) -> Bool[Tensor, "batch height width"]:
    """Whether each point stands before the surface of a picture, in a colour that the picture does not show there."""
    w2c = invert_rigid(c2w)
    camera = torch.einsum("bij,bhwj->bhwi", w2c[:, :3, :3], points) + w2c[:, None, None, :3, 3]
    z = camera[..., 2]
    image = torch.einsum("bij,bhwj->bhwi", intrinsics, camera / z.clamp(min=1e-6)[..., None])[..., :2]
    inside = (z > 1e-6) & (image > 0).all(-1) & (image < 1).all(-1)

    def look(maps: Tensor) -> Tensor:
        return F.grid_sample(maps, 2 * image.clamp(-1, 2) - 1, mode="nearest", align_corners=False)

    before = z < (1 - MARGIN) * look(depths[:, None])[:, 0]
    distance = torch.maximum(look(low) - colours, colours - look(high)).clamp(min=0).mean(1)
    return inside & before & (distance > DIFFERENT)


def _colour_range(photo: Float[Tensor, "batch 3 height width"]) -> tuple[Tensor, Tensor]:
    """Lowest and highest value of each channel in the 5x5 pixels around each pixel."""
    high = F.max_pool2d(photo, 5, 1, 2)
    return -F.max_pool2d(-photo, 5, 1, 2), high
