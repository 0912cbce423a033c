"""One Gaussian a pixel from depths, poses and colours."""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import unproject
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.interfaces import MatchedGeometry
from edit3r.types import Gaussians, Views

__all__ = ["splat"]


def splat(
    views: Views,
    geometry: MatchedGeometry,
    opacities: Float[Tensor, "batch view height width"],
    footprint: float,
) -> Gaussians:
    """Round Gaussians at every pixel's depth, standard deviation `footprint` pixels at that depth.

    Ordered view-major, then row-major, colours those of `views`, the same from every side (harmonics of degree 0).
    """
    batch, count = views.images.shape[:2]
    height, width = views.image_size
    points = unproject(geometry.depths, views.intrinsics, geometry.c2w)
    focal = views.intrinsics[..., 0, 0] * width  # [pixels]
    sizes = footprint * geometry.depths / focal[..., None, None]
    colours = views.images.permute(0, 1, 3, 4, 2)
    total = count * height * width
    quats = points.new_zeros(batch, total, 4)
    quats[..., 0] = 1
    return Gaussians(
        means=points.reshape(batch, total, 3),
        scales=sizes.reshape(batch, total, 1).expand(-1, -1, 3).contiguous(),
        quats=quats,
        opacities=opacities.reshape(batch, total),
        harmonics=colour_to_dc(colours).reshape(batch, total, 1, 3),
        view_index=torch.arange(count, device=points.device).repeat_interleave(height * width),
    )
