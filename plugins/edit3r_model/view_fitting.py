"""Photos of any size to what the network takes, and its Gaussians back to the photos' size."""

from dataclasses import dataclass, replace
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.geometry.maps import resampled, size_of

Images = Float[Tensor, "batch view 3 height width"]
Size = tuple[int, int]  # (height, width) [pixels]


@dataclass(frozen=True)
class FittedViews:
    """Views at the network's size, and which part of each image is photo rather than padding."""

    views: Views
    inner_size: Size  # of the photo, from the top-left corner

    def drop_padding(self, reconstruction: Reconstruction) -> Reconstruction:
        """Keep only the Gaussians of pixels that show the photo, and cameras of the photo alone."""
        if self.views.image_size == self.inner_size:
            return reconstruction
        rows, columns = self.inner_size
        size = (self.views.count, *self.views.image_size)
        device = reconstruction.gaussians.means.device
        inside = torch.zeros(size, dtype=torch.bool, device=device)
        inside[:, :rows, :columns] = True
        inside = inside.flatten().repeat_interleave(reconstruction.per_pixel)
        cameras = reconstruction.cameras
        if cameras is not None:
            shares = _shares(self.inner_size, self.views.image_size)
            intrinsics = cameras.intrinsics / cameras.intrinsics.new_tensor(shares)
            cameras = Cameras(cameras.c2w, intrinsics, self.inner_size)
        return replace(
            reconstruction,
            gaussians=reconstruction.gaussians.select(inside),
            cameras=cameras,
        )


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
    unit = patch if mode == "resize" else 1
    inner = _scaled(views.image_size, resolution, unit)
    images = resampled(views.images, inner)
    margins = (0, -inner[1] % patch, 0, -inner[0] % patch)
    if any(margins):
        padded = F.pad(images.flatten(0, 1), margins, mode="replicate")
        images = padded.unflatten(0, images.shape[:2])
    shares = views.intrinsics.new_tensor(_shares(inner, size_of(images)))
    intrinsics = views.intrinsics * shares
    return FittedViews(Views(images, intrinsics, views.names), inner)


def _shares(inner: Size, outer: Size) -> list[list[float]]:
    """Of the photo in width and height of the padded image: factors of normalised intrinsics."""
    return [[inner[1] / outer[1]], [inner[0] / outer[0]], [1.0]]


def _scaled(size: Size, resolution: int, unit: int) -> Size:
    """`size` with at most about `resolution`^2 pixels, in multiples of `unit`, at least one."""
    height, width = size
    scale = min(1.0, resolution / (height * width) ** 0.5)
    height, width = (max(1, round(side * scale / unit)) * unit for side in size)
    return height, width
