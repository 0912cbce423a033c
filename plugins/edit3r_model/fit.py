"""From photos of any size to what the network takes, and back."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.types import Gaussians, Views


@dataclass(frozen=True)
class FittedViews:
    """Views at the network's size, and which part of each picture is photo rather than padding."""

    views: Views
    inner_size: tuple[int, int]  # (height, width) of the photo, from the top-left corner [pixels]

    def drop_padding(self, gaussians: Gaussians) -> Gaussians:
        """Only the Gaussians of pixels that show the photo."""
        (height, width), (rows, columns) = self.views.image_size, self.inner_size
        if (height, width) == (rows, columns):
            return gaussians
        inside = torch.zeros(self.views.count, height, width, dtype=torch.bool, device=gaussians.means.device)
        inside[:, :rows, :columns] = True
        return gaussians.select(inside.flatten())


def fit_views(views: Views, patch: int, resolution: int, mode: Literal["resize", "pad"]) -> FittedViews:
    """Scale photos down to at most `resolution`^2 pixels and to sides that are multiples of `patch`.

    Photos that already are both stay untouched, and none is enlarged beyond the next multiple. `resize` stretches the
    sides to the nearest multiples (the normalised intrinsics stay true, pixels get slightly oblong); `pad` keeps
    pixels square and repeats the last row and column, with intrinsics adjusted.
    """
    height, width = views.image_size
    scale = min(1.0, resolution / (height * width) ** 0.5)
    if mode == "resize":
        size = _multiple(height * scale, patch), _multiple(width * scale, patch)
        return FittedViews(Views(resize(views.images, size), views.intrinsics, views.names), size)
    inner = max(1, round(height * scale)), max(1, round(width * scale))
    padded = _pad(resize(views.images, inner), patch)
    shares = views.intrinsics.new_tensor([inner[1] / padded.shape[-1], inner[0] / padded.shape[-2], 1.0])
    return FittedViews(Views(padded, views.intrinsics * shares[:, None], views.names), inner)


def resize(images: Float[Tensor, "*batch 3 height width"], size: tuple[int, int]) -> Float[Tensor, "*batch 3 h w"]:
    """Antialiased bicubic resampling, kept in [0, 1]; the same tensor when the size is right already."""
    if tuple(images.shape[-2:]) == size:
        return images
    flat = images.flatten(0, -4)
    small = F.interpolate(flat, size=size, mode="bicubic", align_corners=False, antialias=True).clamp(0, 1)
    return small.unflatten(0, images.shape[:-3])


def _pad(images: Tensor, patch: int) -> Float[Tensor, "batch view 3 h w"]:
    """Repeat the last row and column up to the next multiples of `patch`."""
    height, width = images.shape[-2:]
    margins = (0, -width % patch, 0, -height % patch)
    return F.pad(images.flatten(0, 1), margins, mode="replicate").unflatten(0, images.shape[:2])


def _multiple(length: float, patch: int) -> int:
    """The multiple of `patch` nearest to `length`, at least one."""
    return max(1, round(length / patch)) * patch
