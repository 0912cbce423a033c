"""Photos of any size to what the network takes, and its Gaussians back to the photos' size."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.types import DC, Gaussians, Views

MIN_VIEWS = 2

Images = Float[Tensor, "batch view 3 height width"]
Maps = Float[Tensor, "batch_view channel height width"]
Rows = Float[Tensor, "batch gaussian channel"]
Size = tuple[int, int]  # (height, width) [pixels]

DEPTH_JUMP = 0.05
"""Where neighbouring centres differ by more than this share of their distance, none lies between:
take the nearest.
"""


def check_views(views: Views) -> None:
    """Raise InputError for fewer than two views, or naming the view whose image or intrinsics
    cannot be used.
    """
    if views.count < MIN_VIEWS:
        raise InputError(
            f"the network places views relative to each other and needs at least {MIN_VIEWS}, got "
            f"{views.count}; add a "
            f"photo taken from another place."
        )
    for index in range(views.count):
        name = f"view {index}" + (f" ({views.names[index]})" if views.names else "")
        intrinsics = views.intrinsics[:, index]
        _require_finite(f"{name}: its image", views.images[:, index])
        _require_finite(f"{name}: its intrinsics matrix", intrinsics)
        focal = intrinsics.diagonal(dim1=-2, dim2=-1)[:, :2]
        if (focal <= 0).any():
            raise InputError(
                f"{name}: focal lengths must be positive, got {focal[0].tolist()} (normalised)."
            )


def _require_finite(what: str, tensor: Tensor) -> None:
    bad = int((~tensor.isfinite()).sum())
    if bad:
        raise InputError(f"{what} holds {bad} values that are not finite.")


@dataclass(frozen=True)
class FittedViews:
    """Views at the network's size, and which part of each image is photo rather than padding."""

    views: Views
    inner_size: Size  # of the photo, from the top-left corner

    def drop_padding(self, gaussians: Gaussians) -> Gaussians:
        """Keep only the Gaussians of pixels that show the photo."""
        if self.views.image_size == self.inner_size:
            return gaussians
        rows, columns = self.inner_size
        size = (self.views.count, *self.views.image_size)
        inside = torch.zeros(size, dtype=torch.bool, device=gaussians.means.device)
        inside[:, :rows, :columns] = True
        return gaussians.select(inside.flatten())


def fit_views(
    views: Views,
    patch: int,
    resolution: int,
    mode: Literal["resize", "pad"],
) -> FittedViews:
    """Scale images down to at most `resolution`^2 pixels and to sides that are multiples of
    `patch`.

    Images that already are both stay untouched, and none is enlarged beyond the next multiple.
    `resize` stretches the sides to the nearest multiples (the normalised intrinsics stay true,
    pixels get slightly oblong); `pad` keeps pixels square and repeats the last row and column, with
    intrinsics adjusted.
    """
    unit = patch if mode == "resize" else 1
    inner = _scaled(views.image_size, resolution, unit)
    images = resize(views.images, inner)
    margins = (0, -inner[1] % patch, 0, -inner[0] % patch)
    if any(margins):
        padded = F.pad(images.flatten(0, 1), margins, mode="replicate")
        images = padded.unflatten(0, images.shape[:2])
    height, width = images.shape[-2:]
    shares = views.intrinsics.new_tensor([inner[1] / width, inner[0] / height, 1.0])
    intrinsics = views.intrinsics * shares[:, None]
    return FittedViews(Views(images, intrinsics, views.names), inner)


def _scaled(size: Size, resolution: int, unit: int = 1) -> Size:
    """`size` with at most about `resolution`^2 pixels, in multiples of `unit`, at least one."""
    height, width = size
    scale = min(1.0, resolution / (height * width) ** 0.5)
    height, width = (max(1, round(side * scale / unit)) * unit for side in size)
    return height, width


def resize(images: Images, size: Size) -> Images:
    """Resample images (antialiased bicubic, kept in [0, 1]); the same tensor when the size is right
    already.
    """
    if tuple(images.shape[-2:]) == size:
        return images
    flat = images.flatten(0, 1)
    small = F.interpolate(flat, size, mode="bicubic", antialias=True).clamp(0, 1)
    return small.unflatten(0, images.shape[:2])


def regrid(gaussians: Gaussians, grid: Size, finer: Size, images: Images) -> Gaussians:
    """Return one Gaussian per pixel of `finer` (rows, columns) instead of `grid`, for each view.

    Centres, opacities and harmonics are interpolated, centres not across depth jumps; scales shrink
    with the pixel spacing. The difference between image and coarse image goes into the constant
    colour, so colours are as sharp as the image. Orientations are the nearest coarse pixel's.
    """
    views = images.shape[1]

    def maps(rows: Rows) -> Maps:
        return rows.unflatten(1, (views, *grid)).flatten(0, 1).movedim(-1, 1)

    def rows(maps: Maps) -> Rows:
        return maps.movedim(1, -1).unflatten(0, (-1, views)).flatten(1, 3)

    def resampled(values: Rows, mode: str = "bilinear") -> Rows:
        return rows(F.interpolate(maps(values), finer, mode=mode))

    spacing = (grid[0] * grid[1] / (finer[0] * finer[1])) ** 0.5
    harmonics = resampled(gaussians.harmonics.flatten(2)).unflatten(-1, (-1, 3)).clone()
    harmonics[:, :, 0] += rows(_detail(images, grid, finer)) / DC
    view_index = torch.arange(views, device=images.device)
    return Gaussians(
        means=rows(_within_surfaces(maps(gaussians.means), finer)),
        scales=resampled(gaussians.scales.log()).exp() * spacing,
        quats=resampled(gaussians.quats, "nearest-exact"),
        opacities=resampled(gaussians.opacities[..., None]).squeeze(-1).clamp(0, 1),
        harmonics=harmonics,
        view_index=view_index.repeat_interleave(finer[0] * finer[1]),
    )


def finer_grid(grid: Size, image_size: Size, resolution: int) -> Size:
    """Return the image's size, limited to about `resolution`^2 pixels, and never coarser than
    `grid`.
    """
    height, width = _scaled(image_size, resolution)
    return max(grid[0], height), max(grid[1], width)


def _detail(images: Images, grid: Size, finer: Size) -> Maps:
    """What the images show on the finer grid beyond what the coarse one holds."""
    coarse = resize(images, grid).flatten(0, 1)
    smooth = F.interpolate(coarse, finer, mode="bilinear")
    return resize(images, finer).flatten(0, 1) - smooth


def _within_surfaces(means: Maps, size: Size) -> Maps:
    """Centres interpolated bilinearly, except between surfaces."""
    smooth = F.interpolate(means, size, mode="bilinear")
    nearest = F.interpolate(means, size, mode="nearest-exact")
    distance = nearest.norm(dim=1, keepdim=True)
    jumps = (smooth - nearest).norm(dim=1, keepdim=True) > DEPTH_JUMP * distance
    return torch.where(jumps, nearest, smooth)
