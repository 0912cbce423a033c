"""Where the pixels of a view lie in another view, and images warped along that."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject

__all__ = ["Correspondences", "find_correspondences", "partner_views", "warp"]


@dataclass(frozen=True)
class Correspondences:
    """Where each pixel of each view lies in the view's partner (see `partner_views`)."""

    coordinates: Float[Tensor, "batch view height width 2"]  # normalised (x, y) in the partner's image
    inside: Float[Tensor, "batch view height width"]  # 1: in front of the partner and within its image, else 0
    depth_ratio: Float[Tensor, "batch view height width"]  # log(own depth there / partner's depth), in [-1, 1]
    # < 0: floats in front of what the partner sees; > 0: hidden behind it


def partner_views(views: int) -> list[int]:
    """The view that each of `views` views is compared with: view 0, and view 1 for view 0 itself."""
    return [1] + [0] * (views - 1)


def find_correspondences(
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    c2w: Float[Tensor, "batch view 4 4"],
) -> Correspondences:
    """Project each view's depth map into the view's partner; `depths` are camera z, `intrinsics` normalised."""
    batch, views, height, width = depths.shape
    partners = partner_views(views)
    points = unproject(depths, intrinsics, c2w).reshape(batch, views, height * width, 3)
    coordinates, z = project(points, intrinsics[:, partners], c2w[:, partners])
    coordinates, z = coordinates.reshape(batch, views, height, width, 2), z.reshape(batch, views, height, width)
    inside = ((z > 1e-6) & (coordinates > 0).all(-1) & (coordinates < 1).all(-1)).to(depths.dtype)
    coordinates = torch.where((z > 1e-6)[..., None], coordinates, torch.full_like(coordinates, -1)).clamp(-1, 2)
    seen = warp(depths[:, partners, None], coordinates, mode="nearest")[:, :, 0]
    ratio = torch.log(z.clamp(min=1e-6) / seen.clamp(min=1e-6)).clamp(-1, 1)
    return Correspondences(coordinates, inside, ratio * inside)


def warp(
    images: Float[Tensor, "*batch channel height width"],
    coordinates: Float[Tensor, "*batch height2 width2 2"],
    mode: str = "bilinear",
    padding: str = "border",
) -> Float[Tensor, "*batch channel height2 width2"]:
    """Sample `images` at normalised `coordinates` (x, y); pixel centres as in `cameras.pixel_grid`.

    `mode` ('bilinear' or 'nearest') and `padding` ('border' repeats the edge, 'zeros') are those of `F.grid_sample`.
    """
    flat, grid = images.reshape(-1, *images.shape[-3:]), coordinates.reshape(-1, *coordinates.shape[-3:]) * 2 - 1
    sampled = F.grid_sample(flat, grid, mode=mode, padding_mode=padding, align_corners=False)
    return sampled.reshape(*images.shape[:-2], *coordinates.shape[-3:-1])
