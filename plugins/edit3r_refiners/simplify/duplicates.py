"""Surfaces that an earlier view shows already."""

import torch
from jaxtyping import Bool, Int
from torch import Tensor

from edit3r.geometry.harmonics import dc_to_colour
from edit3r.types import Cameras, Gaussians
from edit3r_refiners.simplify.placement import Placement, place_in
from edit3r_refiners.simplify.settings import SimplifySettings

OPAQUE = 0.5
AS_FINE = 1.25  # an earlier view may show the surface with pixels this much larger
AROUND = tuple((dy, dx) for dy in (0, -1, 1) for dx in (0, -1, 1))


def duplicates(
    gaussians: Gaussians, cameras: Cameras, placement: Placement, settings: SimplifySettings
) -> Bool[Tensor, "gaussian"]:
    """Gaussians (batch 1) on a surface that an earlier view shows at the same colour and no coarser.

    The pixel of the earlier view they fall on must hold an opaque Gaussian that stays itself, within
    `duplicate_depth`, and it or one around it must be within `duplicate_colour` (two views do not sample the same
    points).
    """
    found = torch.zeros_like(placement.view, dtype=torch.bool)
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    for earlier in range(cameras.count - 1):
        later = ((placement.view > earlier) & ~found).nonzero()[:, 0]
        owner = _owners(placement, (gaussians.opacities[0] > OPAQUE) & ~found, earlier, cameras.image_size)
        x, y, depth = place_in(gaussians.means[0, later], cameras, earlier)
        column, row = x.floor().long(), y.floor().long()
        other = _at(owner, row, column)
        shown = (other >= 0) & ((depth - placement.depth[other]).abs() < settings.duplicate_depth * depth)
        shown &= placement.footprint[other] < AS_FINE * placement.footprint[later]
        later, column, row = later[shown], column[shown], row[shown]
        alike = torch.zeros_like(later, dtype=torch.bool)
        for dy, dx in AROUND:
            near = _at(owner, row + dy, column + dx)
            difference = (colours[later] - colours[near]).square().mean(-1)
            alike |= (near >= 0) & (difference <= settings.duplicate_colour**2)
        found[later[alike]] = True
    return found


def _owners(
    placement: Placement, usable: Bool[Tensor, "gaussian"], view: int, size: tuple[int, int]
) -> Int[Tensor, "row column"]:
    """Index of the nearest usable Gaussian at each pixel of `view`, -1 where there is none."""
    height, width = size
    row, column = placement.row, placement.column
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (placement.depth > 0)
    index = ((placement.view == view) & inside & usable).nonzero()[:, 0]
    index = index[placement.depth[index].argsort(descending=True, stable=True)]
    owner = torch.full((height * width,), -1, dtype=torch.long, device=index.device)
    owner[row[index] * width + column[index]] = index  # of several, the last written is the nearest
    return owner.view(height, width)


def _at(owner: Tensor, row: Tensor, column: Tensor) -> Int[Tensor, "point"]:
    height, width = owner.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    return torch.where(inside, owner[row.clamp(0, height - 1), column.clamp(0, width - 1)], -1)
