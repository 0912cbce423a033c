"""Coarse, blurred layers for what no photo shows: around the images, behind their depth edges,
behind their surfaces.

The apron continues each image beyond its border, so that a camera that moved a little does not look
past the edge. The backdrop continues the surface behind each depth edge a short way under what
stands before it, so that a gap shows what surrounds it instead of nothing. The lining repeats
measured surfaces right behind themselves, so that no black shows through where they are faint. All
are made of large soft Gaussians, and none stands before what a photo shows.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import MatchedGeometry
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.geometry.cameras import (
    from_pixels,
    pixel_scales,
    pixels_to_gaussians,
    to_pixels,
    unproject,
)
from edit3r.geometry.warping import seen_by, stands_before_others

__all__ = ["apron", "backdrop", "lining"]

APRON_BLOCK, BACKDROP_BLOCK, LINING_BLOCK = (
    4,
    6,
    4,
)  # side of the square of pixels that one Gaussian stands for
# Standard deviation in blocks: neighbours close up without gaps.
APRON_FOOTPRINT, BACKDROP_FOOTPRINT, LINING_FOOTPRINT = 0.6, 0.8, 0.6
REACH = 0.1  # how far a surface goes on behind what stands before it [long sides]
EDGE = 1.02  # ratio of depths above which one surface stands before another
BEHIND = 1.01  # relative depth at which the backdrop lies behind its surface
UNDER = 1.1  # relative depth at which the lining lies behind its surface
# ratio of depths among neighbouring blocks below which their surface is lined: none behind thin
# things
SMOOTH = 1.15
FAINT = 0.9  # mean opacity of a block's Gaussians below which it is lined
SURE = 0.9  # share of a block that was measured, above which it counts as measured
BLURS = 3  # passes of a 3x3 mean, in blocks
# share of an apron's width; a fade over all of it costs 0.6 dB where a new view looks past the
# photos
FADING = 0.3


def apron(
    views: Views, geometry: MatchedGeometry, width: float, opacity: float
) -> Gaussians:
    """Rims `width` (of the long side) wide around every registered view, in the colours of `views`.

    They fade to nothing outwards, so that the scene ends softly.
    """
    pad = APRON_BLOCK * math.ceil(width * max(views.image_size) / APRON_BLOCK)
    wide, depths = _widened(views, geometry.depths, pad)
    outside = _outside_all(wide, depths, views, geometry)
    fading = opacity * _towards_rim(views.image_size, pad, depths.shape[-2:]).to(depths)
    return _layer(wide, depths, geometry, fading * outside, APRON_FOOTPRINT)


def backdrop(views: Views, geometry: MatchedGeometry, opacity: float) -> Gaussians:
    """What lies behind depth edges and guessed depths of every registered view, in the colours of
    `views`.

    A guess in front of it may be faint without letting the empty background through.
    """
    return _hidden_layer(
        views, geometry, opacity, BACKDROP_FOOTPRINT, *_surface_behind(views, geometry)
    )


def lining(
    views: Views,
    geometry: MatchedGeometry,
    opacities: Float[Tensor, "batch view height width"],
    opacity: float,
) -> Gaussians:
    """Measured smooth surfaces of every registered view, where faint, once more right behind
    themselves.

    Nothing but what other photos show there shines through then. Guesses stay as faint as they are:
    something behind a wrong one hides what others show. `opacities` are those of the pixels'
    Gaussians.
    """
    shape = geometry.depths.shape[:2]
    blocks = tuple(math.ceil(side / LINING_BLOCK) for side in views.image_size)
    single = torch.stack(
        (1 / geometry.depths, opacities.detach(), geometry.confidence), 2
    )
    maps = torch.cat((views.images, single), 2).flatten(0, 1)
    colour, inverse, opaque, sure = F.adaptive_avg_pool2d(maps, blocks).split(
        (3, 1, 1, 1), 1
    )
    smooth = F.max_pool2d(inverse, 3, 1, 1) < SMOOTH * -F.max_pool2d(-inverse, 3, 1, 1)
    needed = smooth & (sure >= SURE) & (opaque < FAINT)
    depths = UNDER / -F.adaptive_max_pool2d(-maps[:, 3:4], blocks)
    parts = (x.unflatten(0, shape) for x in (depths[:, 0], colour, needed[:, 0]))
    return _hidden_layer(views, geometry, opacity, LINING_FOOTPRINT, *parts)


def _hidden_layer(
    views: Views,
    geometry: MatchedGeometry,
    opacity: float,
    footprint: float,
    depths: Float[Tensor, "batch view rows columns"],
    colours: Float[Tensor, "batch view 3 rows columns"],
    needed: Bool[Tensor, "batch view rows columns"],
) -> Gaussians:
    """A Gaussian for each block that is `needed` and stands before nothing that a registered view
    shows.
    """
    placed = geometry.registered[..., None, None]
    points = unproject(depths, views.intrinsics, geometry.c2w)
    needed = (
        needed
        & placed
        & ~stands_before_others(
            points, geometry.depths * placed, views.intrinsics, geometry.c2w
        )
    )
    coarse = Views(colours, views.intrinsics)
    return _layer(
        coarse, depths, geometry, opacity * needed.to(depths.dtype), footprint
    )


def _layer(
    coarse: Views,
    depths: Float[Tensor, "batch view rows columns"],
    geometry: MatchedGeometry,
    opacities: Float[Tensor, "batch view rows columns"],
    footprint: float,
) -> Gaussians:
    """One Gaussian for each pixel of `coarse` that is not transparent in every scene."""
    cameras = Cameras(geometry.c2w, coarse.intrinsics, coarse.image_size)
    scales = pixel_scales(depths, coarse.intrinsics, footprint)
    gaussians = pixels_to_gaussians(coarse.images, depths, cameras, scales, opacities)
    return gaussians.select((gaussians.opacities > 0).any(dim=0))


def _widened(
    views: Views, depths: Float[Tensor, "batch view height width"], pad: int
) -> tuple[Views, Float[Tensor, "batch view rows columns"]]:
    """The images with their borders continued by `pad` pixels, in blocks, and the depths continued
    likewise.
    """
    full = tuple(side + 2 * pad for side in views.image_size)
    maps = torch.cat((views.images, 1 / depths[:, :, None]), 2).flatten(0, 1)
    inner = F.adaptive_avg_pool2d(
        maps, tuple(math.ceil(side / APRON_BLOCK) for side in views.image_size)
    )
    reach = max(
        1, min(pad, *views.image_size) // (2 * APRON_BLOCK) - 1
    )  # over a quarter of the apron, not one row
    smooth = F.avg_pool2d(inner, 2 * reach + 1, 1, reach, count_include_pad=False)
    coarse = F.pad(smooth, (pad // APRON_BLOCK,) * 4, mode="replicate").unflatten(
        0, depths.shape[:2]
    )
    intrinsics = to_pixels(views.intrinsics, views.image_size)
    intrinsics[..., :2, 2] += pad
    return Views(coarse[:, :, :3], from_pixels(intrinsics, full)), 1 / coarse[:, :, 3]


def _towards_rim(
    image_size: tuple[int, int], pad: int, blocks: tuple[int, int]
) -> Float[Tensor, "rows columns"]:
    """How much of the apron is left in each block: 1 near the image, falling to 0 in the outer
    share `FADING`.
    """
    beyond = []
    for side, count in zip(image_size, blocks):
        centre = (torch.arange(count) + 0.5) * (
            side + 2 * pad
        ) / count - pad  # [pixels] from the image's first
        beyond.append(torch.maximum(-centre, centre - side).clamp(min=0) / pad)
    return ((1 - torch.maximum(beyond[0][:, None], beyond[1])) / FADING).clamp(0, 1)


def _outside_all(
    wide: Views,
    depths: Float[Tensor, "batch view rows columns"],
    views: Views,
    geometry: MatchedGeometry,
) -> Bool[Tensor, "batch view rows columns"]:
    """Blocks of registered views whose centre no registered view shows, their own among them."""
    points = unproject(depths, wide.intrinsics, geometry.c2w).flatten(2, 3)
    outside = geometry.registered[..., None].expand(points.shape[:3]).clone()
    for other in range(views.count):
        for view in range(views.count):
            outside[:, view] &= ~seen_by(
                points[:, view], geometry, views.intrinsics, other
            )
    return outside.view(depths.shape)


def _surface_behind(
    views: Views, geometry: MatchedGeometry
) -> tuple[
    Float[Tensor, "batch view rows columns"],
    Float[Tensor, "batch view 3 rows columns"],
    Bool[Tensor, "batch view rows columns"],
]:
    """Per block: depth and colour of the farthest surface within reach, and whether anything needs
    it.
    """
    shape = geometry.depths.shape[:2]
    blocks = tuple(math.ceil(side / BACKDROP_BLOCK) for side in views.image_size)
    maps = torch.cat(
        (
            views.images,
            1 / geometry.depths[:, :, None],
            geometry.confidence[:, :, None],
        ),
        2,
    ).flatten(0, 1)
    colour, inverse, sure = F.adaptive_avg_pool2d(maps, blocks).split((3, 1, 1), 1)
    reach = max(1, round(REACH * max(views.image_size) / BACKDROP_BLOCK))
    farthest, where = F.max_pool2d(
        -inverse, 2 * reach + 1, 1, reach, return_indices=True
    )
    behind = (
        colour.flatten(2).gather(2, where.flatten(2).expand(-1, 3, -1)).view_as(colour)
    )
    needed = (inverse > EDGE * -farthest) | (sure < SURE)
    smooth = torch.cat((behind, -farthest), 1)
    for _ in range(BLURS):
        smooth = F.avg_pool2d(smooth, 3, 1, 1, count_include_pad=False)
    depths = BEHIND / smooth[:, 3].unflatten(0, shape)
    return depths, smooth[:, :3].unflatten(0, shape), needed[:, 0].unflatten(0, shape)
