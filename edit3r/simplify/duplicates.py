"""Surfaces that an earlier view shows already."""

import torch
from jaxtyping import Bool
from torch import Tensor

from edit3r.geometry.cameras import project
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.simplify.cells import Placement
from edit3r.types import Cameras, Gaussians


def duplicates(
    gaussians: Gaussians, cameras: Cameras, placement: Placement, depth: float, colour: float
) -> Bool[Tensor, "gaussian"]:
    """Gaussians (batch 1) that lie on a surface of an earlier view, at the same colour and no finer.

    The earlier view's pixel they fall on must hold an opaque Gaussian within `depth` (relative) and within twice
    `colour` (root mean square over the channels, sRGB), seen at least as finely.
    """
    found = torch.zeros_like(placement.view, dtype=torch.bool)
    for earlier in range(cameras.count - 1):
        later = placement.view > earlier
        owner = _owners(gaussians, placement, earlier, cameras.image_size)
        found[later] |= _shown(gaussians, cameras, placement, owner, earlier, later, depth, colour)
    return found


def _owners(gaussians: Gaussians, placement: Placement, view: int, size: tuple[int, int]) -> Tensor:
    """Index of the opaque Gaussian at each pixel of `view`, -1 where there is none."""
    height, width = size
    inside = (placement.x >= 0) & (placement.x < width) & (placement.y >= 0) & (placement.y < height)
    index = ((placement.view == view) & inside & (gaussians.opacities[0] > 0.5)).nonzero()[:, 0]
    owner = torch.full((height * width,), -1, dtype=torch.long, device=index.device)
    owner[placement.y[index] * width + placement.x[index]] = index
    return owner


def _shown(gaussians, cameras, placement, owner, earlier: int, later: Tensor, depth: float, colour: float) -> Tensor:
    height, width = cameras.image_size
    image, z = project(gaussians.means[0, later], cameras.intrinsics[0, earlier], cameras.c2w[0, earlier])
    x, y = (image * image.new_tensor([width, height])).floor().clamp(-1e6, 1e6).long().unbind(-1)
    inside = (z > 0) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    other = torch.where(inside, owner[(y.clamp(0, height - 1) * width + x.clamp(0, width - 1))], -1)
    near = (z - placement.depth[other]).abs() < depth * z
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    alike = (colours[later] - colours[other]).square().mean(-1).sqrt() < 2 * colour
    as_fine = placement.footprint[other] < 1.25 * placement.footprint[later]
    return (other >= 0) & near & alike & as_fine
