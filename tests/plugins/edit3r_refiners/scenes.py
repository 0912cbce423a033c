"""Small scenes of one Gaussian per pixel, from pictures and depths that are known by formula."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import intrinsics_from_fov, unproject
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r_testing.scenes import FOV_X, photograph

OPACITY = 0.9


def cameras_side_by_side(
    count: int, image_size: tuple[int, int], step: float = 0.1
) -> Cameras:
    """Cameras that look straight ahead, `step` apart."""
    c2w = torch.eye(4).repeat(1, count, 1, 1)
    c2w[0, :, 0, 3] = step * torch.arange(count)
    return Cameras(
        c2w, intrinsics_from_fov(FOV_X, image_size).repeat(1, count, 1, 1), image_size
    )


def gaussian_per_pixel(
    colours: Float[Tensor, "view 3 height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
) -> Gaussians:
    """Round Gaussians of half a pixel's size on every pixel's ray."""
    views, height, width = depths.shape
    means = unproject(depths, cameras.intrinsics[0], cameras.c2w[0]).reshape(1, -1, 3)
    focal = cameras.intrinsics[0, 0, 0, 0] * width
    scales = (0.5 * depths / focal).reshape(1, -1, 1).expand(1, -1, 3).clone()
    quats = torch.tensor([1.0, 0, 0, 0]).repeat(1, means.shape[1], 1)
    harmonics = colour_to_dc(colours.permute(0, 2, 3, 1).reshape(1, -1, 1, 3))
    index = torch.arange(views).repeat_interleave(height * width)
    return Gaussians(
        means, scales, quats, torch.full(means.shape[:2], OPACITY), harmonics, index
    )


def flat_wall(views: int = 1, size: int = 64) -> tuple[Gaussians, Cameras]:
    """A grey wall that fills every picture."""
    cameras = cameras_side_by_side(views, (size, size))
    return gaussian_per_pixel(
        torch.full((views, 3, size, size), 0.6),
        torch.full((views, size, size), 2.0),
        cameras,
    ), cameras


def textured(
    views: int = 2, size: tuple[int, int] = (48, 64)
) -> tuple[Gaussians, Cameras, Float[Tensor, "..."]]:
    """Balls before a wall, their true surfaces as Gaussians; also the photos `[1, view, 3, height,
    width]`.
    """
    scene = photograph(views, size)
    return (
        gaussian_per_pixel(scene.views.images[0], scene.depths[0], scene.cameras),
        scene.cameras,
        scene.views.images,
    )
