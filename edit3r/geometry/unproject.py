"""From pixels with depths to Gaussians; their bare points are `edit3r.geometry.cameras.unproject`."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import unproject
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.types import Cameras, Gaussians

__all__ = ["pixel_scales", "pixels_to_gaussians"]


def pixel_scales(
    depths: Float[Tensor, "batch view height width"], intrinsics: Float[Tensor, "batch view 3 3"], footprint: float
) -> Float[Tensor, "batch view height width"]:
    """How long `footprint` pixels are at the pixels' depths [unit of `depths`]; `intrinsics` are normalised."""
    focal = intrinsics[..., 0, 0] * depths.shape[-1]  # [pixels]
    return footprint * depths / focal[..., None, None]


def pixels_to_gaussians(
    images: Float[Tensor, "batch view 3 height width"],
    depths: Float[Tensor, "batch view height width"],
    cameras: Cameras,
    scales: Float[Tensor, "batch view height width"],
    opacities: Float[Tensor, "batch view height width"],
) -> Gaussians:
    """One round Gaussian at every pixel's depth, ordered view by view, then row by row.

    `depths` are camera z and `scales` standard deviations in the unit of the cameras' poses. Each Gaussian shows the
    colour of its pixel from every side (harmonics of degree 0). Differentiable.
    """
    batch, views, height, width = depths.shape
    count = views * height * width
    points = unproject(depths, cameras.intrinsics, cameras.c2w)
    quats = points.new_zeros(batch, count, 4)
    quats[..., 0] = 1
    return Gaussians(
        means=points.reshape(batch, count, 3),
        scales=scales.reshape(batch, count, 1).expand(-1, -1, 3).contiguous(),
        quats=quats,
        opacities=opacities.reshape(batch, count),
        harmonics=colour_to_dc(images.permute(0, 1, 3, 4, 2)).reshape(batch, count, 1, 3),
        view_index=torch.arange(views, device=points.device).repeat_interleave(height * width),
    )
