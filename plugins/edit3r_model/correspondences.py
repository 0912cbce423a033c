"""Where each pixel of each view lies in a partner view."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.warping import warp


@dataclass(frozen=True)
class Correspondences:
    """Where each pixel of each view lies in the view's partner (see `partner_views`)."""

    # normalised (x, y) in the partner's image
    coordinates: Float[Tensor, "batch view height width 2"]
    # 1: in front of the partner and within its image, else 0
    inside: Float[Tensor, "batch view height width"]
    # log(own depth there / partner's depth), in [-1, 1]
    depth_ratio: Float[Tensor, "batch view height width"]


def partner_views(views: int) -> list[int]:
    """The view that each of `views` views is compared with: view 0, and view 1 for view 0."""
    return [1] + [0] * (views - 1)


def find_correspondences(
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    c2w: Float[Tensor, "batch view 4 4"],
) -> Correspondences:
    """Project each view's depth map into its partner; `depths` are camera z."""
    batch, views, height, width = depths.shape
    partners = partner_views(views)
    points = unproject(depths, intrinsics, c2w).reshape(batch, views, height * width, 3)
    coordinates, z = project(points, intrinsics[:, partners], c2w[:, partners])
    coordinates = coordinates.unflatten(2, (height, width))
    z = z.view_as(depths)
    inside = ((z > 1e-6) & (coordinates > 0).all(-1) & (coordinates < 1).all(-1)).to(
        depths.dtype
    )
    coordinates = torch.where(
        (z > 1e-6)[..., None], coordinates, torch.full_like(coordinates, -1)
    ).clamp(-1, 2)
    seen = warp(depths[:, partners, None], coordinates, mode="nearest")[:, :, 0]
    ratio = torch.log(z.clamp(min=1e-6) / seen.clamp(min=1e-6)).clamp(-1, 1)
    return Correspondences(coordinates, inside, ratio * inside)
