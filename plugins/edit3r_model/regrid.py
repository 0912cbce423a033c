"""Gaussians of the network's pixel grid on a finer one, with the photo's own detail in their colours."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.harmonics import DC
from edit3r.types import Gaussians
from edit3r_model.fit import resize

DEPTH_JUMP = 0.05
"""Where neighbouring centres differ by more than this share of their distance, none lies between: take the nearest."""


def regrid(
    gaussians: Gaussians,
    grid: tuple[int, int],
    finer: tuple[int, int],
    photos: Float[Tensor, "batch view 3 height width"],
) -> Gaussians:
    """One Gaussian per pixel of `finer` instead of `grid`, for each view.

    Centres, opacities and harmonics are interpolated, centres not across depth jumps; scales shrink with the pixel
    spacing. The difference between photo and coarse photo goes into the constant colour, so colours are as sharp as
    the photo. Orientations are the nearest coarse pixel's.
    """
    views = photos.shape[1]
    means, scales, quats = (_maps(x, views, grid) for x in (gaussians.means, gaussians.scales.log(), gaussians.quats))
    opacities = _maps(gaussians.opacities[..., None], views, grid)
    harmonics = _maps(gaussians.harmonics.flatten(2), views, grid)
    spacing = (grid[0] * grid[1] / (finer[0] * finer[1])) ** 0.5
    fine_harmonics = _rows(_smooth(harmonics, finer), views).unflatten(-1, (-1, 3)).clone()
    fine_harmonics[:, :, 0] += _rows(_detail(photos, grid, finer).flatten(0, 1), views) / DC
    return Gaussians(
        means=_rows(_within_surfaces(means, finer), views),
        scales=_rows(_smooth(scales, finer), views).exp() * spacing,
        quats=_rows(_nearest(quats, finer), views),
        opacities=_rows(_smooth(opacities, finer), views).squeeze(-1).clamp(0, 1),
        harmonics=fine_harmonics,
        view_index=torch.arange(views, device=means.device).repeat_interleave(finer[0] * finer[1]),
    )


def finer_grid(grid: tuple[int, int], photo: tuple[int, int], resolution: int) -> tuple[int, int]:
    """The photo's size, limited to about `resolution`^2 pixels, and never coarser than `grid`."""
    scale = min(1.0, resolution / (photo[0] * photo[1]) ** 0.5)
    return max(grid[0], round(photo[0] * scale)), max(grid[1], round(photo[1] * scale))


def _detail(photos: Tensor, grid: tuple[int, int], finer: tuple[int, int]) -> Tensor:
    """What the photo shows on the finer grid beyond what the coarse one holds, [batch, view, 3, height, width]."""
    coarse = resize(photos, grid).flatten(0, 1)
    return resize(photos, finer) - _smooth(coarse, finer).unflatten(0, photos.shape[:2])


def _within_surfaces(means: Tensor, size: tuple[int, int]) -> Tensor:
    """Bilinear centres, except between surfaces."""
    smooth, nearest = _smooth(means, size), _nearest(means, size)
    distance = nearest.norm(dim=1, keepdim=True)
    jumps = (smooth - nearest).norm(dim=1, keepdim=True) > DEPTH_JUMP * distance
    return torch.where(jumps, nearest, smooth)


def _smooth(maps: Tensor, size: tuple[int, int]) -> Tensor:
    return F.interpolate(maps, size=size, mode="bilinear", align_corners=False)


def _nearest(maps: Tensor, size: tuple[int, int]) -> Tensor:
    return F.interpolate(maps, size=size, mode="nearest-exact")


def _maps(rows: Tensor, views: int, grid: tuple[int, int]) -> Float[Tensor, "batch_view channel height width"]:
    """One value row per Gaussian to one map per view."""
    return rows.unflatten(1, (views, *grid)).flatten(0, 1).movedim(-1, 1)


def _rows(maps: Tensor, views: int) -> Float[Tensor, "batch gaussian channel"]:
    return maps.movedim(1, -1).unflatten(0, (-1, views)).flatten(1, 3)
