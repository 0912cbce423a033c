"""Where each Gaussian lies on the pictures."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from edit3r.geometry.cameras import project
from edit3r.types import Cameras, Gaussians

FAR_OUTSIDE = 1e6  # pixels


@dataclass(frozen=True)
class Placement:
    """Pixel, depth and pixel footprint of each Gaussian of one scene in the view it belongs to."""

    view: Int[Tensor, "gaussian"]
    x: Float[Tensor, "gaussian"]  # [pixels], pixel centres at +0.5; may lie outside the picture
    y: Float[Tensor, "gaussian"]
    depth: Float[Tensor, "gaussian"]  # camera z; behind the camera where <= 0
    footprint: Float[Tensor, "gaussian"]  # size of a pixel at that depth [scene units]

    @property
    def column(self) -> Int[Tensor, "gaussian"]:
        return self.x.floor().long()

    @property
    def row(self) -> Int[Tensor, "gaussian"]:
        return self.y.floor().long()


def place(gaussians: Gaussians, cameras: Cameras) -> Placement:
    """Place the Gaussians of one scene (batch 1) in float64; one without a view is placed in view 0."""
    view = gaussians.view_index.clamp(0, cameras.count - 1)
    x, y, depth = (torch.zeros(gaussians.count, dtype=torch.float64, device=view.device) for _ in range(3))
    for index in range(cameras.count):
        mine = view == index
        x[mine], y[mine], depth[mine] = place_in(gaussians.means[0, mine], cameras, index)
    focal = cameras.intrinsics[0, view, 0, 0] * cameras.image_size[1]
    return Placement(view, x, y, depth, depth.clamp(min=0) / focal)


def place_in(
    points: Float[Tensor, "point 3"], cameras: Cameras, view: int
) -> tuple[Float[Tensor, "point"], Float[Tensor, "point"], Float[Tensor, "point"]]:
    """Column and row [pixels] and camera z of world points in one camera of the scene."""
    height, width = cameras.image_size
    image, z = project(points.double(), cameras.intrinsics[0, view].double(), cameras.c2w[0, view].double())
    x, y = (image * image.new_tensor([width, height])).clamp(-FAR_OUTSIDE, FAR_OUTSIDE).unbind(-1)
    return x, y, z
