"""Made scenes: walls before two cameras side by side, whose images share their inner halves."""

import torch

from edit3r import Cameras, Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc


def eyes():
    """The two cameras."""
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, :, 0, 3] = torch.tensor([-0.5, 0.5])
    intrinsics = torch.tensor([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return Cameras(poses, intrinsics.expand(1, 2, 3, 3), (32, 32))


def wall(depth):
    """Opaque grey Gaussians in a plane; the left half came from view 0, the right from view 1."""
    y, x = torch.meshgrid(
        torch.arange(-1, 1, 1 / 16), torch.arange(-1.6, 1.6, 1 / 16), indexing="ij"
    )
    means = torch.stack((x, y, torch.full_like(x, depth)), -1).view(1, -1, 3)
    count = means.shape[1]
    grey = torch.rand(1, count, 1, 1, generator=torch.Generator().manual_seed(0))
    return Gaussians(
        means=means,
        scales=torch.full((1, count, 3), 0.04),
        quats=torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        opacities=torch.full((1, count), 0.95),
        harmonics=colour_to_dc(grey.expand(-1, -1, -1, 3)).contiguous(),
        view_index=(means[0, :, 0] > 0).long(),
    )
