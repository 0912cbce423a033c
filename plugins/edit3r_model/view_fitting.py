"""Photos of any size to what the network takes, and its Gaussians back to the photos' size."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Gaussians, Views
from edit3r.errors import InputError
from edit3r.geometry.harmonics import DC

DEPTH_JUMP = 0.05
"""Where neighbouring centres differ by more than this share of their distance, none lies between:
take the nearest.
"""


def check_views(views: Views, least: int) -> None:
    """Raise InputError for fewer than `least` views, or naming the view whose image or intrinsics
    cannot be used.
    """
    if views.count < least:
        raise InputError(
            f"the network places views relative to each other and needs at least {least}, got "
            f"{views.count}; add a "
            f"photo taken from another place."
        )
    for index in range(views.count):
        name = f"view {index}" + (f" ({views.names[index]})" if views.names else "")
        _require_finite(f"{name}: its picture", views.images[:, index])
        _require_finite(f"{name}: its intrinsics matrix", views.intrinsics[:, index])
        focal = views.intrinsics[:, index].diagonal(dim1=-2, dim2=-1)[:, :2]
        if (focal <= 0).any():
            raise InputError(
                f"{name}: focal lengths must be positive, got {focal[0].tolist()} (normalised)."
            )


def _require_finite(what: str, tensor: Float[Tensor, "*shape"]) -> None:
    bad = int((~tensor.isfinite()).sum())
    if bad:
        raise InputError(
            f"{what} holds {bad} values that are not finite (NaN or infinite)."
        )


@dataclass(frozen=True)
class FittedViews:
    """Views at the network's size, and which part of each image is photo rather than padding."""

    views: Views
    inner_size: tuple[
        int, int
    ]  # (height, width) of the photo, from the top-left corner [pixels]

    def drop_padding(self, gaussians: Gaussians) -> Gaussians:
        """Keep only the Gaussians of pixels that show the photo."""
        (height, width), (rows, columns) = self.views.image_size, self.inner_size
        if (height, width) == (rows, columns):
            return gaussians
        inside = torch.zeros(
            self.views.count,
            height,
            width,
            dtype=torch.bool,
            device=gaussians.means.device,
        )
        inside[:, :rows, :columns] = True
        return gaussians.select(inside.flatten())


def fit_views(
    views: Views, patch: int, resolution: int, mode: Literal["resize", "pad"]
) -> FittedViews:
    """Scale images down to at most `resolution`^2 pixels and to sides that are multiples of
    `patch`.

    Images that already are both stay untouched, and none is enlarged beyond the next multiple.
    `resize` stretches the sides to the nearest multiples (the normalised intrinsics stay true,
    pixels get slightly oblong); `pad` keeps pixels square and repeats the last row and column, with
    intrinsics adjusted.
    """
    height, width = views.image_size
    scale = min(1.0, resolution / (height * width) ** 0.5)
    if mode == "resize":
        size = _multiple(height * scale, patch), _multiple(width * scale, patch)
        return FittedViews(
            Views(resize(views.images, size), views.intrinsics, views.names), size
        )
    inner = max(1, round(height * scale)), max(1, round(width * scale))
    padded = _pad(resize(views.images, inner), patch)
    shares = views.intrinsics.new_tensor(
        [inner[1] / padded.shape[-1], inner[0] / padded.shape[-2], 1.0]
    )
    return FittedViews(
        Views(padded, views.intrinsics * shares[:, None], views.names), inner
    )


def resize(
    images: Float[Tensor, "*batch 3 height width"], size: tuple[int, int]
) -> Float[Tensor, "*batch 3 h w"]:
    """Resample images (antialiased bicubic, kept in [0, 1]); the same tensor when the size is right
    already.
    """
    if tuple(images.shape[-2:]) == size:
        return images
    flat = images.flatten(0, -4)
    small = F.interpolate(
        flat, size=size, mode="bicubic", align_corners=False, antialias=True
    ).clamp(0, 1)
    return small.unflatten(0, images.shape[:-3])


def _pad(
    images: Float[Tensor, "batch view 3 height width"], patch: int
) -> Float[Tensor, "batch view 3 h w"]:
    """Repeat the last row and column up to the next multiples of `patch`."""
    height, width = images.shape[-2:]
    margins = (0, -width % patch, 0, -height % patch)
    return F.pad(images.flatten(0, 1), margins, mode="replicate").unflatten(
        0, images.shape[:2]
    )


def _multiple(length: float, patch: int) -> int:
    """The multiple of `patch` nearest to `length`, at least one."""
    return max(1, round(length / patch)) * patch


def regrid(
    gaussians: Gaussians,
    grid: tuple[int, int],
    finer: tuple[int, int],
    images: Float[Tensor, "batch view 3 height width"],
) -> Gaussians:
    """Return one Gaussian per pixel of `finer` (rows, columns) instead of `grid`, for each view.

    Centres, opacities and harmonics are interpolated, centres not across depth jumps; scales shrink
    with the pixel spacing. The difference between image and coarse image goes into the constant
    colour, so colours are as sharp as the image. Orientations are the nearest coarse pixel's.
    """
    views = images.shape[1]
    means, scales, quats = (
        _maps(x, views, grid)
        for x in (gaussians.means, gaussians.scales.log(), gaussians.quats)
    )
    opacities = _maps(gaussians.opacities[..., None], views, grid)
    harmonics = _maps(gaussians.harmonics.flatten(2), views, grid)
    spacing = (grid[0] * grid[1] / (finer[0] * finer[1])) ** 0.5
    fine_harmonics = (
        _rows(_resample(harmonics, finer), views).unflatten(-1, (-1, 3)).clone()
    )
    fine_harmonics[:, :, 0] += (
        _rows(_detail(images, grid, finer).flatten(0, 1), views) / DC
    )
    return Gaussians(
        means=_rows(_within_surfaces(means, finer), views),
        scales=_rows(_resample(scales, finer), views).exp() * spacing,
        quats=_rows(_resample(quats, finer, "nearest-exact"), views),
        opacities=_rows(_resample(opacities, finer), views).squeeze(-1).clamp(0, 1),
        harmonics=fine_harmonics,
        view_index=torch.arange(views, device=means.device).repeat_interleave(
            finer[0] * finer[1]
        ),
    )


def finer_grid(
    grid: tuple[int, int], image_size: tuple[int, int], resolution: int
) -> tuple[int, int]:
    """Return the image's size, limited to about `resolution`^2 pixels, and never coarser than
    `grid`.
    """
    height, width = image_size
    scale = min(1.0, resolution / (height * width) ** 0.5)
    return max(grid[0], round(height * scale)), max(grid[1], round(width * scale))


def _detail(
    images: Float[Tensor, "batch view 3 height width"],
    grid: tuple[int, int],
    finer: tuple[int, int],
) -> Float[Tensor, "batch view 3 h w"]:
    """What the images show on the finer grid beyond what the coarse one holds."""
    coarse = resize(images, grid).flatten(0, 1)
    return resize(images, finer) - _resample(coarse, finer).unflatten(
        0, images.shape[:2]
    )


def _within_surfaces(
    means: Float[Tensor, "batch_view 3 height width"], size: tuple[int, int]
) -> Float[Tensor, "batch_view 3 h w"]:
    """Centres interpolated bilinearly, except between surfaces."""
    smooth, nearest = _resample(means, size), _resample(means, size, "nearest-exact")
    distance = nearest.norm(dim=1, keepdim=True)
    jumps = (smooth - nearest).norm(dim=1, keepdim=True) > DEPTH_JUMP * distance
    return torch.where(jumps, nearest, smooth)


def _resample(
    maps: Float[Tensor, "batch_view channel height width"],
    size: tuple[int, int],
    mode: str = "bilinear",
) -> Float[Tensor, "batch_view channel h w"]:
    return F.interpolate(maps, size=size, mode=mode)


def _maps(
    rows: Float[Tensor, "batch gaussian channel"], views: int, grid: tuple[int, int]
) -> Float[Tensor, "batch_view channel height width"]:
    """One row per Gaussian to one map per view."""
    return rows.unflatten(1, (views, *grid)).flatten(0, 1).movedim(-1, 1)


def _rows(
    maps: Float[Tensor, "batch_view channel height width"], views: int
) -> Float[Tensor, "batch gaussian channel"]:
    """One map per view to one row per Gaussian."""
    return maps.movedim(1, -1).unflatten(0, (-1, views)).flatten(1, 3)
