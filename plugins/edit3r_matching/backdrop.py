"""A coarse, blurred layer behind the photos' surfaces, so that a gap shows what surrounds it instead of nothing.

Nobody photographed what a foreground hides: the backdrop carries the surface behind each depth edge on, a short way
under what stands before it, one large soft Gaussian for a block of pixels. Where a depth was guessed it lies close
behind the guess, which may then be faint without letting the background through. Whatever a photo shows stays in front.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject
from edit3r.interfaces import MatchedGeometry
from edit3r.types import Gaussians, Views
from edit3r_matching.splatting import splat

__all__ = ["backdrop"]

BLOCK = 6
"""Side of the square of pixels that one Gaussian of the backdrop stands for."""

_BLOCK_FOOTPRINT = 0.8  # standard deviation in blocks: neighbours close up without gaps
_REACH = 0.1  # how far a surface goes on behind what stands before it [long sides]
_EDGE = 1.02  # ratio of depths above which one surface stands before another
_BEHIND = 1.01  # relative depth at which the backdrop lies behind its surface
_SURE = 0.9  # share of a block that was measured, above which nothing has to be put behind it
_BLURS = 3  # passes of a 3x3 mean, in blocks


def backdrop(views: Views, geometry: MatchedGeometry, opacity: float) -> Gaussians:
    """What lies behind depth edges and guesses of every registered view, in the colours of `views`."""
    depths, colours, covered = _surface_behind(views, geometry)
    covered &= geometry.registered[..., None, None] & ~_hides_a_photo(depths, views, geometry)
    layer = MatchedGeometry(geometry.c2w, depths, torch.zeros_like(depths), geometry.registered)
    gaussians = splat(Views(colours, views.intrinsics), layer, opacity * covered.to(depths.dtype), _BLOCK_FOOTPRINT)
    return gaussians.select((gaussians.opacities > 0).any(dim=0))


def _surface_behind(
    views: Views, geometry: MatchedGeometry
) -> tuple[
    Float[Tensor, "batch view rows columns"],
    Float[Tensor, "batch view 3 rows columns"],
    Bool[Tensor, "batch view rows columns"],
]:
    """Per block: depth and colour of the farthest surface within reach, and whether anything needs it."""
    shape = geometry.depths.shape[:2]
    blocks = tuple(math.ceil(side / BLOCK) for side in views.image_size)
    maps = torch.cat((views.images, 1 / geometry.depths[:, :, None], geometry.confidence[:, :, None]), 2).flatten(0, 1)
    colour, inverse, sure = F.adaptive_avg_pool2d(maps, blocks).split((3, 1, 1), 1)
    reach = max(1, round(_REACH * max(views.image_size) / BLOCK))
    farthest, where = F.max_pool2d(-inverse, 2 * reach + 1, 1, reach, return_indices=True)
    behind = colour.flatten(2).gather(2, where.flatten(2).expand(-1, 3, -1)).view_as(colour)
    needed = (inverse > _EDGE * -farthest) | (sure < _SURE)
    smooth = torch.cat((behind, -farthest), 1)
    for _ in range(_BLURS):
        smooth = F.avg_pool2d(smooth, 3, 1, 1, count_include_pad=False)
    depths = _BEHIND / smooth[:, 3].unflatten(0, shape)
    return depths, smooth[:, :3].unflatten(0, shape), needed[:, 0].unflatten(0, shape)


def _hides_a_photo(
    depths: Float[Tensor, "batch view rows columns"], views: Views, geometry: MatchedGeometry
) -> Bool[Tensor, "batch view rows columns"]:
    """Blocks that would stand before what another photo shows."""
    points = unproject(depths, views.intrinsics, geometry.c2w)
    hides = torch.zeros_like(depths, dtype=torch.bool)
    for view in range(views.count):
        for other in range(views.count):
            if other != view:
                places, z = project(points[:, view].flatten(1, 2), views.intrinsics[:, other], geometry.c2w[:, other])
                grid = (2 * places - 1).unflatten(1, depths.shape[2:])
                surface = geometry.depths[:, other, None] * geometry.registered[:, other, None, None, None]
                seen = F.grid_sample(surface, grid, mode="nearest", padding_mode="zeros", align_corners=False)[:, 0]
                z = z.view_as(seen)
                hides[:, view] |= (z > 0) & (z < seen)
    return hides
