"""Coarse, blurred layers for what no photo shows: around images and behind depth edges.

The rim continues each image beyond its border, so that a camera that moved a little does not look
past the edge. The background layer continues the surface behind each depth edge a short way under
what stands before it, so that a gap shows what surrounds it instead of nothing: beside the edge in
the colour and depth of the nearest place of that surface, and far behind all as a mean of what is
farthest. Both are made of large soft Gaussians, and none stands before what a photo shows.
"""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.geometry.cameras import (
    from_pixels,
    pixel_scales,
    pixels_to_gaussians,
    to_pixels,
    unproject,
)
from edit3r.kit.geometry.warping import SAME_SURFACE, seen_by, stands_before_others

__all__ = ["background_layer", "rim"]

# Side of the square of pixels that one Gaussian stands for.
RIM_BLOCK = 4
BACKGROUND_BLOCK = 6
# The numbers of this block: docs/notes/classical.md.
CONTINUED_BLOCK = 4
CONTINUED_FOOTPRINT = 0.7
RIM_WIDTH = 2  # of a depth edge, on which a depth belongs to neither surface [pixels]

# The numbers of this block: docs/notes/ledger.md.
# Standard deviation in blocks: neighbours close up without gaps.
RIM_FOOTPRINT = 0.6
BACKGROUND_FOOTPRINT = 0.8

# The numbers of this block: docs/notes/ledger.md.
REACH = 0.1  # how far a surface goes on behind what stands before it [long sides]
EDGE = 1.02  # ratio of depths above which one surface stands before another
BEHIND = 1.01  # relative depth at which the background layer lies behind its surface
SURE = 0.9  # share of a block that was measured, above which it counts as measured
BLURS = 3  # passes of a 3x3 mean, in blocks
# Share of a rim's width; a fade over all of it costs 0.6 dB where a new view looks past the photos.
FADING = 0.3


def rim(views: Views, geometry: Geometry, width: float, opacity: float) -> Gaussians:
    """Rims `width` (of the long side) wide around every registered view, in the colours of `views`.

    They fade to nothing outwards, so that the scene ends softly.
    """
    pad = RIM_BLOCK * math.ceil(width * max(views.image_size) / RIM_BLOCK)
    wide, depths = _widened(views, geometry.depths, pad)
    outside = _outside_all(wide, depths, views, geometry)
    height, width = depths.shape[-2:]
    fading = _fading(views.image_size, pad, (height, width)).to(depths)
    return _layer(wide, depths, geometry, opacity * fading * outside, RIM_FOOTPRINT)


def background_layer(views: Views, geometry: Geometry, opacity: float) -> Gaussians:
    """What lies behind depth edges and guessed depths of registered views, in `views`' colours.

    A guess in front of it may be faint without letting the empty background through.
    """
    layers = _farthest(views, geometry), _continued_surfaces(views, geometry)
    placed = geometry.registered[..., None, None]
    made = []
    for coarse, depths, needed, footprint in layers:
        points = unproject(depths, views.intrinsics, geometry.c2w)
        hiding = stands_before_others(
            points, geometry.depths * placed, views.intrinsics, geometry.c2w
        )
        opacities = opacity * (needed & placed & ~hiding).to(depths.dtype)
        made.append(_layer(coarse, depths, geometry, opacities, footprint))
    return Gaussians.cat(made)


_Layer = tuple[
    Views,
    Float[Tensor, "batch view rows columns"],
    Bool[Tensor, "batch view rows columns"],
    float,
]
"""Colours, depths, where it is needed, and its footprint [its pixels]."""


def _farthest(views: Views, geometry: Geometry) -> _Layer:
    """The farthest depth around each block, smoothed, behind guesses and all that is nearer."""
    shape = geometry.depths.shape[:2]
    colour, inverse, sure = _block_means(
        BACKGROUND_BLOCK, views, 1 / geometry.depths, geometry.confidence
    )
    reach = max(1, round(REACH * max(views.image_size) / BACKGROUND_BLOCK))
    farthest, where = F.max_pool2d(
        -inverse, 2 * reach + 1, 1, reach, return_indices=True
    )
    behind = colour.flatten(2).gather(2, where.flatten(2).expand(-1, 3, -1))
    needed = (inverse > EDGE * -farthest) | (sure < SURE)
    smooth = torch.cat((behind.view_as(colour), -farthest), 1)
    for _ in range(BLURS):
        smooth = F.avg_pool2d(smooth, 3, 1, 1, count_include_pad=False)
    coarse = Views(smooth[:, :3].unflatten(0, shape), views.intrinsics)
    depths = (BEHIND / smooth[:, 3]).unflatten(0, shape)
    return coarse, depths, needed[:, 0].unflatten(0, shape), BACKGROUND_FOOTPRINT


def _continued_surfaces(views: Views, geometry: Geometry) -> _Layer:
    """The surface beside each depth edge, gone on behind what stands before it: each pixel there
    has the colour and depth of the nearest place of a surface that is farther away.
    """
    shape, (height, width) = geometry.depths.shape[:2], views.image_size
    depths = geometry.depths.flatten(0, 1)
    reach = max(1, round(REACH * max(views.image_size)))
    nearest = torch.stack([_nearest_behind(one, reach) for one in depths])
    place = nearest.clamp(min=0).flatten(1)
    behind = depths.flatten(1).gather(1, place).view_as(depths)
    colour = views.images.flatten(0, 1).flatten(2)
    colour = colour.gather(2, place[:, None].expand(-1, 3, -1))
    start = CONTINUED_BLOCK // 2
    rows, columns = (
        torch.arange(min(start, side - 1), side, CONTINUED_BLOCK, device=depths.device)
        for side in (height, width)
    )

    def sampled(maps: Tensor) -> Tensor:
        chosen = maps[..., rows[:, None], columns].contiguous()
        return chosen.unflatten(0, shape)

    smooth = _mean_within(
        torch.cat((colour.unflatten(2, (height, width)), 1 / behind[:, None]), 1),
        nearest >= 0,
    )
    return (
        Views(sampled(smooth[:, :3]), views.intrinsics),
        sampled(torch.maximum(1 / smooth[:, 3], BEHIND * depths)),
        sampled(nearest) >= 0,
        CONTINUED_FOOTPRINT,
    )


def _nearest_behind(
    depths: Float[Tensor, "height width"], reach: int
) -> Int[Tensor, "height width"]:
    """Index of the nearest pixel beside a depth edge, if it is within `reach` and its surface lies
    behind the pixel's own; else -1.
    """
    apart, side = 1 + SAME_SURFACE, 2 * RIM_WIDTH + 1
    farthest, closest = (
        sign * F.max_pool2d(sign * depths[None, None], side, 1, RIM_WIDTH)[0, 0]
        for sign in (1, -1)
    )
    beside = (depths >= farthest / EDGE) & (depths > apart * closest)
    if not beside.any():
        return torch.full_like(beside, -1, dtype=torch.long)
    distance, (row, column) = distance_transform_edt(
        ~beside.numpy(force=True), return_indices=True
    )
    nearest = torch.from_numpy(row * depths.shape[1] + column).long().to(depths.device)
    near = torch.from_numpy(distance <= reach).to(depths.device)
    behind = depths.flatten()[nearest] > apart * depths
    return torch.where(near & behind, nearest, -1)


def _mean_within(
    maps: Float[Tensor, "image channel height width"],
    inside: Bool[Tensor, "image height width"],
) -> Float[Tensor, "image channel height width"]:
    """Means over 3x3 pixels of those inside, `BLURS` times; outside the maps as they are."""
    weight = inside[:, None].to(maps)
    share = F.avg_pool2d(weight, 3, 1, 1).clamp(min=torch.finfo(maps.dtype).tiny)
    for _ in range(BLURS):
        mean = F.avg_pool2d(maps * weight, 3, 1, 1) / share
        maps = torch.where(inside[:, None], mean, maps)
    return maps


def _block_means(
    block: int, views: Views, *maps: Float[Tensor, "batch view height width"]
) -> tuple[Tensor, ...]:
    """Mean colour, then the mean of each map, in blocks of pixels; scenes and views in one axis."""
    height, width = (math.ceil(side / block) for side in views.image_size)
    stacked = torch.cat((views.images, torch.stack(maps, 2)), 2).flatten(0, 1)
    return F.adaptive_avg_pool2d(stacked, (height, width)).split(
        (3, *(1 for _ in maps)), 1
    )


def _layer(
    coarse: Views,
    depths: Float[Tensor, "batch view rows columns"],
    geometry: Geometry,
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
    """Images and depths with their borders continued by `pad` pixels, in blocks."""
    colour, inverse = _block_means(RIM_BLOCK, views, 1 / depths)
    blocks = pad // RIM_BLOCK
    # Depth goes on by the mean over a quarter of the rim, not by one row.
    most = min(colour.shape[-2:]) // 2 - 1
    inverse = _continued(inverse, max(1, min(blocks // 2 - 1, most)), blocks)
    colour = _softening(colour, blocks, most)
    coarse = torch.cat((colour, inverse), 1)
    coarse = coarse.unflatten(0, depths.shape[:2])
    intrinsics = to_pixels(views.intrinsics, views.image_size)
    intrinsics[..., :2, 2] += pad
    height, width = (side + 2 * pad for side in views.image_size)
    return Views(
        coarse[:, :, :3], from_pixels(intrinsics, (height, width))
    ), 1 / coarse[:, :, 3]


def _softening(
    colour: Float[Tensor, "image 3 rows columns"], blocks: int, most: int
) -> Float[Tensor, "image 3 wide_rows wide_columns"]:
    """Colours continued by `blocks`: the border's own beside it, means of ever more of it farther
    out, so that nothing on the border becomes a stripe.
    """
    height, width = colour.shape[-2:]
    beyond = _beyond((height, width), blocks).to(colour)
    soft = _continued(colour, 1, blocks)
    reach = 1
    while 2 * reach <= min(blocks, most):
        share = ((beyond - reach) / reach).clamp(0, 1)
        reach *= 2
        soft = torch.lerp(soft, _continued(colour, reach, blocks), share)
    return soft


def _continued(
    maps: Float[Tensor, "image channel rows columns"], reach: int, blocks: int
) -> Float[Tensor, "image channel wide_rows wide_columns"]:
    """Means over `reach` blocks to each side, continued beyond the borders as they are there."""
    smooth = F.avg_pool2d(maps, 2 * reach + 1, 1, reach, count_include_pad=False)
    return F.pad(smooth, (blocks,) * 4, mode="replicate")


def _beyond(
    size: tuple[int, int], blocks: int
) -> Float[Tensor, "wide_rows wide_columns"]:
    """How far outside of the border each block lies; inside 0 or less."""
    rows, columns = (
        torch.maximum(
            -torch.arange(-blocks, side + blocks),
            torch.arange(-blocks, side + blocks) - side + 1,
        )
        for side in size
    )
    return torch.maximum(rows[:, None], columns).double()


def _fading(
    image_size: tuple[int, int], pad: int, blocks: tuple[int, int]
) -> Float[Tensor, "rows columns"]:
    """How much of the rim is left in each block: 1 near the image, 0 in the outer `FADING`."""
    beyond = []
    for side, count in zip(image_size, blocks):
        wide = side + 2 * pad
        # [pixels] from the image's first one.
        centre = (torch.arange(count) + 0.5) * wide / count - pad
        beyond.append(torch.maximum(-centre, centre - side).clamp(min=0) / pad)
    rows, columns = beyond
    return ((1 - torch.maximum(rows[:, None], columns)) / FADING).clamp(0, 1)


def _outside_all(
    wide: Views,
    depths: Float[Tensor, "batch view rows columns"],
    views: Views,
    geometry: Geometry,
) -> Bool[Tensor, "batch view rows columns"]:
    """Blocks of registered views whose centre no registered view shows, their own among them."""
    points = unproject(depths, wide.intrinsics, geometry.c2w).flatten(2, 3)
    outside = geometry.registered[..., None].expand(points.shape[:3]).clone()
    for other in range(views.count):
        for view in range(views.count):
            seen = seen_by(points[:, view], geometry, views.intrinsics, other)
            outside[:, view] &= ~seen
    return outside.view(depths.shape)
