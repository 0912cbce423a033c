"""The part of each picture that some Gaussians may show in, and a camera for that part alone."""

import torch
from torch import Tensor

from edit3r.geometry.cameras import from_pixels, to_pixels
from edit3r.simplify.placement import place_in
from edit3r.types import Cameras, Gaussians

REACH = 3.4  # standard deviations; at opacity 1, a Gaussian falls below 1/255 at 3.33
SMOOTHING = 0.3  # variance that rasterizers may add to each footprint [square pixels]
SPARE = 2  # pixels around
LEAST_DEPTH = 0.05  # of the median depth; whatever is nearer to the camera may reach anywhere

Box = tuple[int, int, int, int]
"""top, left, bottom, right [pixels]; the last two are excluded."""


def boxes_of(gaussians: Gaussians, cameras: Cameras) -> list[Box | None]:
    """The smallest box per camera that all the Gaussians (batch 1) stay in; None: they show nowhere."""
    return [_box(gaussians, cameras, index) for index in range(cameras.count)]


def cropped(camera: Cameras, box: Box) -> Cameras:
    """One camera that takes only the box of its picture, pixel for pixel.

    Rasterizers flatten Gaussians as seen near the picture's border; large ones around the box may differ by a little.
    """
    top, left, bottom, right = box
    intrinsics = to_pixels(camera.intrinsics, camera.image_size)
    intrinsics[..., 0, 2] -= left
    intrinsics[..., 1, 2] -= top
    size = (bottom - top, right - left)
    return Cameras(camera.c2w, from_pixels(intrinsics, size), size)


def _box(gaussians: Gaussians, cameras: Cameras, index: int) -> Box | None:
    height, width = cameras.image_size
    if gaussians.count == 0:
        return None
    x, y, depth = place_in(gaussians.means[0], cameras, index)
    front = depth > 0
    if not front.any():
        return None
    if bool((depth[front] < LEAST_DEPTH * depth[front].median()).any()):
        return 0, 0, height, width
    x, y, depth, size = x[front], y[front], depth[front], gaussians.scales[0].amax(-1).double()[front]
    reach = _reach(x, y, depth, size, cameras, index)
    low_x, high_x = float((x - reach).min()), float((x + reach).max())
    low_y, high_y = float((y - reach).min()), float((y + reach).max())
    left, top = max(0, int(low_x) - SPARE), max(0, int(low_y) - SPARE)
    right, bottom = min(width, int(high_x) + SPARE + 1), min(height, int(high_y) + SPARE + 1)
    return (top, left, bottom, right) if top < bottom and left < right else None


def _reach(x: Tensor, y: Tensor, depth: Tensor, size: Tensor, cameras: Cameras, index: int) -> Tensor:
    """How far footprints reach from their centres [pixels]; slanted rays stretch them by 1 / cos^2 at most."""
    matrix = to_pixels(cameras.intrinsics, cameras.image_size)[0, index].double()
    slope = ((x - matrix[0, 2]) / matrix[0, 0]).square() + ((y - matrix[1, 2]) / matrix[1, 1]).square()
    focal = torch.maximum(matrix[0, 0], matrix[1, 1])
    return REACH * ((focal * size / depth * (1 + slope)).square() + SMOOTHING).sqrt()
