"""Which Gaussians and which bands of harmonics the rendered images of a scene need."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import to_pixels
from edit3r.kit.geometry.paths import between_and_around

PATH_CAMERAS = 2  # cameras between and around, per input view
MOST_PATH_CAMERAS = 8  # of many views, which show nearly all themselves
PATH_REDUCTION = 2  # of the sides of their images
# of what they show: a rim beyond the photos' borders counts too; no figure kept
PATH_WIDENING = 1.5


def viewpoints(cameras: Cameras) -> tuple[Cameras, ...]:
    """Return the input cameras, and smaller and wider ones from between and around them.

    What only a new viewpoint uncovers, or what lies past the border of the photos, must stay
    although no input view needs it.
    """
    if cameras.count == 1:
        return (cameras,)
    frames = min(PATH_CAMERAS * cameras.count, MOST_PATH_CAMERAS)
    path = between_and_around(cameras, frames)
    height, width = (max(1, size // PATH_REDUCTION) for size in cameras.image_size)
    intrinsics = path.intrinsics.clone()
    intrinsics[..., :2, :2] /= PATH_WIDENING
    return cameras, replace(path, intrinsics=intrinsics, image_size=(height, width))


def visible_weight(
    gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer
) -> Float[Tensor, "gaussian"]:
    """The most that each Gaussian adds to the input views or to the others [their pixels]."""
    weights = []
    for seen_from in viewpoints(cameras):
        area = (first_focal(cameras) / first_focal(seen_from)) ** 2
        weights.append(area * rasterizer.contributions(gaussians, seen_from)[0])
    return torch.stack(weights).amax(0)


def first_focal(cameras: Cameras) -> float:
    """Return the horizontal focal length of the first camera [pixels]."""
    return float(to_pixels(cameras.intrinsics, cameras.image_size)[0, 0, 0, 0])


def drop_unneeded_harmonics(
    gaussians: Gaussians,
    cameras: Sequence[Cameras],
    rasterizer: Rasterizer,
    tolerance: float,
) -> Gaussians:
    """Cut the harmonics to the lowest degree whose images differ nowhere by more than `tolerance`
    [sRGB].

    Bands that are zero go without rendering. The others are judged by images: a band may matter to
    single Gaussians and to no pixel.
    """
    used = _highest_used_degree(gaussians.harmonics)
    full = (
        [rasterizer.render(gaussians, seen_from).images for seen_from in cameras]
        if used
        else []
    )
    for degree in range(used):
        fewer = _cut(gaussians, degree)
        if all(
            float((rasterizer.render(fewer, seen_from).images - images).abs().amax())
            <= tolerance
            for seen_from, images in zip(cameras, full)
        ):
            return fewer
    return _cut(gaussians, used)


def _cut(gaussians: Gaussians, degree: int) -> Gaussians:
    return replace(
        gaussians, harmonics=gaussians.harmonics[:, :, : (degree + 1) ** 2].contiguous()
    )


def _highest_used_degree(
    harmonics: Float[Tensor, "batch gaussian coefficient 3"],
) -> int:
    """Return the degree of the last coefficient that is not zero everywhere."""
    used = harmonics.ne(0).any(dim=3).any(dim=1).any(dim=0).nonzero()
    return int(float(used.max()) ** 0.5) if used.numel() else 0
