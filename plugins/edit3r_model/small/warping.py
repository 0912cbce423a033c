"""What a view sees at the same 3D points as its partner: pictures pulled along the matched geometry."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject


@dataclass(frozen=True)
class Correspondence:
    """Where each pixel of each view lies in its partner view (view 0; for view 0 itself view 1)."""

    places: Float[Tensor, "batch view height width 2"]  # normalised picture coordinates in the partner
    inside: Float[Tensor, "batch view height width"]  # 1: in front of the partner and within its picture
    depth_ratio: Float[Tensor, "batch view height width"]  # log(own depth there / partner's depth), in [-1, 1]
    # < 0: floats in front of what the partner sees; > 0: hidden behind it


def partners(views: int) -> list[int]:
    """Partner of each view: the reference view 0, and view 1 for the reference itself."""
    return [1] + [0] * (views - 1)


def correspond(
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    c2w: Float[Tensor, "batch view 4 4"],
) -> Correspondence:
    """Project each view's depth map into its partner."""
    batch, views, height, width = depths.shape
    index = partners(views)
    points = unproject(depths, intrinsics, c2w).reshape(batch, views, height * width, 3)
    places, z = project(points, intrinsics[:, index], c2w[:, index])
    places, z = places.reshape(batch, views, height, width, 2), z.reshape(batch, views, height, width)
    inside = ((z > 1e-6) & (places > 0).all(-1) & (places < 1).all(-1)).to(depths.dtype)
    places = torch.where((z > 1e-6)[..., None], places, torch.full_like(places, -1)).clamp(-1, 2)
    seen = pull(depths[:, index, None], places, mode="nearest")[:, :, 0]
    ratio = torch.log(z.clamp(min=1e-6) / seen.clamp(min=1e-6)).clamp(-1, 1)
    return Correspondence(places, inside, ratio * inside)


def pull(
    pictures: Float[Tensor, "batch view channel height width"],
    places: Float[Tensor, "batch view height2 width2 2"],
    mode: str = "bilinear",
) -> Float[Tensor, "batch view channel height2 width2"]:
    """Sample pictures at normalised places; outside, the border is repeated."""
    batch, views = pictures.shape[:2]
    sampled = F.grid_sample(
        pictures.flatten(0, 1), places.flatten(0, 1) * 2 - 1, mode=mode, padding_mode="border", align_corners=False
    )
    return sampled.unflatten(0, (batch, views))


def token_places(places: Float[Tensor, "batch height width 2"], stride: int) -> Float[Tensor, "batch height2 width2 2"]:
    """Places of the tokens: the mean over each `stride` x `stride` cell."""
    return F.avg_pool2d(places.permute(0, 3, 1, 2), stride).permute(0, 2, 3, 1)
