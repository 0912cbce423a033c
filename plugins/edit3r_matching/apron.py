"""A coarse, blurred rim around every photo, so that a camera which moved a little does not look past the edge.

Nobody photographed what is there: the rim continues depth and colour of the photo's border, one large soft Gaussian for
a block of pixels, and stays out of everything that another photo shows.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import from_pixels, to_pixels, unproject
from edit3r.interfaces import MatchedGeometry
from edit3r.types import Gaussians, Views
from edit3r_matching.splatting import splat
from edit3r_matching.visibility import shown_by

__all__ = ["apron"]

BLOCK = 4
"""Side of the square of pixels that one Gaussian of the rim stands for."""

_BLOCK_FOOTPRINT = 0.6  # standard deviation in blocks: neighbours close up without gaps


def apron(views: Views, geometry: MatchedGeometry, width: float, opacity: float) -> Gaussians:
    """Rims `width` (of the long side) wide around every registered view."""
    pad = BLOCK * math.ceil(width * max(views.image_size) / BLOCK)
    wide, depths = _widened(views, geometry.depths, pad)
    rim = _outside_all(wide, depths, views, geometry)
    opacities = opacity * rim.to(depths.dtype)
    sides = MatchedGeometry(geometry.c2w, depths, torch.zeros_like(depths), geometry.registered)
    gaussians = splat(wide, sides, opacities, _BLOCK_FOOTPRINT)
    return gaussians.select((gaussians.opacities > 0).any(dim=0))


def _widened(
    views: Views, depths: Float[Tensor, "batch view height width"], pad: int
) -> tuple[Views, Float[Tensor, "batch view rows columns"]]:
    """The photos with their borders continued by `pad` pixels, in blocks, and the depths continued likewise."""
    height, width = views.image_size
    full = (height + 2 * pad, width + 2 * pad)
    blocks = (math.ceil(full[0] / BLOCK), math.ceil(full[1] / BLOCK))
    maps = torch.cat((views.images, 1 / depths[:, :, None]), 2).flatten(0, 1)
    reach = 2 * min(pad // 2, height // 2, width // 2) // 2  # an average over the border's surroundings, not one row
    smooth = _mean_around(_mean_around(maps, 2, reach), 3, reach)
    coarse = F.interpolate(F.pad(smooth, (pad,) * 4, mode="replicate"), blocks, mode="area")
    coarse = coarse.view(*views.images.shape[:2], 4, *blocks)
    intrinsics = to_pixels(views.intrinsics, views.image_size)
    intrinsics[..., :2, 2] += pad
    return Views(coarse[:, :, :3], from_pixels(intrinsics, full)), 1 / coarse[:, :, 3]


def _mean_around(maps: Float[Tensor, "batch channel height width"], side: int, reach: int) -> Tensor:
    """Mean over what lies at most `reach` away along one side, inside the picture.

    From running sums in float64, whose cost does not grow with the reach.
    """
    size = maps.shape[side]
    sums = F.pad(maps, (0, 0, 1, 0) if side == 2 else (1, 0)).cumsum(side, dtype=torch.float64)
    places = torch.arange(size, device=maps.device)
    first, end = (places - reach).clamp(min=0), (places + reach + 1).clamp(max=size)
    count = (end - first).view(-1, 1) if side == 2 else end - first
    return ((sums.index_select(side, end) - sums.index_select(side, first)) / count).to(maps.dtype)


def _outside_all(
    wide: Views, depths: Float[Tensor, "batch view rows columns"], views: Views, geometry: MatchedGeometry
) -> Bool[Tensor, "batch view rows columns"]:
    """Blocks whose centre no registered photo shows, their own among them."""
    points = unproject(depths, wide.intrinsics, geometry.c2w).flatten(2, 3)
    outside = geometry.registered[..., None].expand(points.shape[:3]).clone()
    for other in range(views.count):
        for view in range(views.count):
            outside[:, view] &= ~shown_by(points[:, view], geometry, views.intrinsics, other)
    return outside.view(depths.shape)
