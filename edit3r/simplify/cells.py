"""Where each Gaussian lies on the pictures: the quadtree cells that merging and duplicate search work on."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from edit3r.geometry.cameras import project
from edit3r.types import Cameras, Gaussians


@dataclass(frozen=True)
class Placement:
    """Pixel, depth and pixel footprint of each Gaussian of one scene in the view it belongs to."""

    view: Int[Tensor, "gaussian"]
    x: Int[Tensor, "gaussian"]  # column [pixels]; may lie outside the picture
    y: Int[Tensor, "gaussian"]  # row [pixels]
    depth: Float[Tensor, "gaussian"]  # camera z
    footprint: Float[Tensor, "gaussian"]  # size of a pixel at that depth [scene units]


def place(gaussians: Gaussians, cameras: Cameras) -> Placement:
    """Place the Gaussians of one scene (batch 1); one without a view is placed in view 0."""
    view = gaussians.view_index.clamp(0, cameras.count - 1)
    height, width = cameras.image_size
    x, y = torch.zeros_like(view), torch.zeros_like(view)
    depth = torch.zeros_like(gaussians.opacities[0])
    for index in range(cameras.count):
        mine = view == index
        image, z = project(gaussians.means[0, mine], cameras.intrinsics[0, index], cameras.c2w[0, index])
        x[mine], y[mine] = (image * image.new_tensor([width, height])).floor().clamp(-1e6, 1e6).long().unbind(-1)
        depth[mine] = z
    focal = cameras.intrinsics[0, view, 0, 0] * width
    return Placement(view, x, y, depth, depth / focal)


def cell_keys(placement: Placement, level: int) -> Int[Tensor, "gaussian"]:
    """A number per quadtree cell with sides of 2^level pixels, different for different views."""
    span = 1 << 22
    return (placement.view * span + (placement.y >> level) + span // 2) * span + (placement.x >> level) + span // 2
