"""Covariances that follow the surface: flat discs, one a pixel, whose short axis is the normal that
the depths show.
"""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Gaussians

_SMOOTH = 5
"""Side of the square of pixels over which normals are averaged: depths come in steps."""


Points = Float[Tensor, "batch view height width 3"]


def discs(
    gaussians: Gaussians, grid: tuple[int, int, int], thickness: float
) -> Gaussians:
    """Flatten round pixel-aligned Gaussians of `grid` (views, height, width) to `thickness` along
    the normal.

    No gradient goes through the normals; means and scales stay differentiable.
    """
    with torch.no_grad():
        normals = surface_normals(gaussians.means.unflatten(1, grid)).flatten(1, 3)
    # The shortest rotation from the z axis to the normal: w = 1 + n_z, (x, y, z) = z axis x normal.
    x, y, z = normals.unbind(-1)
    quats = F.normalize(torch.stack((1 + z, -y, x, torch.zeros_like(z)), -1), dim=-1)
    shape = gaussians.scales.new_tensor([1.0, 1.0, thickness])
    return replace(gaussians, scales=gaussians.scales * shape, quats=quats)


def surface_normals(points: Points) -> Points:
    """Unit normals of maps of points, z > 0; (0, 0, 1) where neighbours tell nothing."""
    across, down = (_nearer_difference(points, axis) for axis in (3, 2))
    normals = torch.linalg.cross(across, down)
    # A disc has no front: all are turned to positive z.
    normals = torch.where(normals[..., 2:] < 0, -normals, normals)
    maps = F.normalize(normals, dim=-1).flatten(0, 1).movedim(-1, 1)
    padded = F.pad(maps, (_SMOOTH // 2,) * 4, mode="replicate")
    smooth = F.avg_pool2d(padded, _SMOOTH, 1).movedim(1, -1)
    smooth = smooth.unflatten(0, points.shape[:2])
    upright = smooth.new_tensor([0.0, 0.0, 1e-6])
    return F.normalize(smooth + upright, dim=-1)


def _nearer_difference(points: Points, axis: int) -> Points:
    """Difference to the nearer of two neighbours along `axis`: no object's edge is bridged."""
    steps = points.diff(dim=axis)
    ahead = torch.cat((steps, steps.narrow(axis, -1, 1)), axis)
    behind = torch.cat((steps.narrow(axis, 0, 1), steps), axis)
    nearer = ahead.norm(dim=-1, keepdim=True) < behind.norm(dim=-1, keepdim=True)
    return torch.where(nearer, ahead, behind)
