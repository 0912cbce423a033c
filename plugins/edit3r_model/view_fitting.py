"""Photos of any size to what the network takes, and its Gaussians back to the photos' size."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Gaussians, Views

Images = Float[Tensor, "batch view 3 height width"]
Size = tuple[int, int]  # (height, width) [pixels]


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


def _scaled(size: Size, resolution: int, unit: int) -> Size:
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
