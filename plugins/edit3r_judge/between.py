"""What is guessed half-way between photos: the views that a flight shows and no photo does.

A photo whose depth is mostly guessed does no harm where its neighbours measured the same place, and
a guess on a blank wall is seldom seen. What is seen is a pattern half-way that nobody measured.
"""

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.contract.types import Cameras, Views
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.paths import half_way
from edit3r.kit.geometry.warping import nearest_views

__all__ = ["guessed_between"]

LONGEST = 172  # size at which photos are looked at [pixels]
NEAR_VIEWS = 4  # others whose measurements count half-way from a photo to its nearest
BESIDE = 2  # pixels around a measured point that count as measured: points lie apart
AROUND = 0.03  # half the side of the window in which colours are compared [long sides]
BLANK = 0.02  # standard deviation of colours [sRGB] below which a surface shows nothing


@torch.no_grad()
def guessed_between(geometry: Geometry, photos: Views) -> Float[Tensor, "batch view"]:
    """For each photo the share of the view half-way to its nearest one that shows a pattern whose
    depth no photo measured; 1 for photos that were not placed, or alone.
    """
    share = min(1.0, LONGEST / max(photos.image_size))
    height, width = (max(1, round(share * side)) for side in photos.image_size)
    views = geometry.calibrated(photos).at((height, width)).to("cpu")
    geometry = geometry.at((height, width)).to("cpu")
    shares = torch.ones(geometry.registered.shape)
    for scene, registered in enumerate(geometry.registered):
        placed = registered.nonzero()[:, 0].tolist()
        if len(placed) > 1:
            half_way = _HalfWay(geometry, views, scene, placed)
            shares[scene, placed] = torch.tensor(half_way.guessed())
    return shares


class _HalfWay:
    """The placed views of one scene, and what they show half-way between two of them."""

    def __init__(
        self, geometry: Geometry, views: Views, scene: int, placed: list[int]
    ) -> None:
        self.images = views.images[scene, placed]
        self.intrinsics = views.intrinsics[scene, placed]
        self.c2w = geometry.c2w[scene, placed]
        cameras = Cameras(self.c2w[None], self.intrinsics[None], views.image_size)
        self.cameras, self.pairs = half_way(cameras)
        depths = geometry.depths[scene, placed]
        self.points = unproject(depths, self.intrinsics, self.c2w)
        self.measured = geometry.confidence[scene, placed] >= 0.5
        self.near = nearest_views(self.c2w[None], depths[None], NEAR_VIEWS)

    def guessed(self) -> list[float]:
        """Of each view the share between it and its nearest one."""
        shares = {}
        for pose, pair in zip(self.cameras.c2w[0], self.pairs):
            seen = {*pair, *self.near[pair[0]], *self.near[pair[1]]}
            colours, measured = self._drawn(sorted(seen), pose, pair[0])
            shares[pair] = float((~measured & _patterned(colours)).float().mean())
        centres = self.c2w[:, :3, 3]
        return [
            shares[
                min(
                    (pair for pair in self.pairs if view in pair),
                    key=lambda pair: float(torch.dist(*centres[list(pair)])),
                )
            ]
            for view in range(len(self.c2w))
        ]

    def _drawn(
        self, views: list[int], pose: Tensor, lens: int
    ) -> tuple[Float[Tensor, "4 height width"], Bool[Tensor, "height width"]]:
        """What the views show from `pose` through the lens of view `lens`, point by point: colours
        (the last channel is 1 where there are any), and where one of them measured it.
        """
        height, width = self.images.shape[-2:]
        points = self.points[views].flatten(0, 2)
        pixels, depth = project(points[None], self.intrinsics[[lens]], pose[None])
        pixels, depth = pixels[0], depth[0]
        inside = (depth > 0) & ((pixels > 0) & (pixels < 1)).all(-1)
        column, row = (pixels * pixels.new_tensor([width, height])).long().T
        place = row * width + column
        measured = torch.zeros(height * width)
        measured[place[inside & self.measured[views].flatten()]] = 1
        nearest_last = depth[inside].argsort(descending=True)
        colours = np.zeros((height * width, 4), np.float32)  # the last write counts
        own = self.images[views].permute(0, 2, 3, 1).flatten(0, 2)[inside]
        colours[place[inside][nearest_last].numpy(), :3] = own[nearest_last].numpy()
        colours[place[inside].numpy(), 3] = 1
        shown = torch.from_numpy(colours).T.unflatten(1, (height, width))
        return shown, dilate(measured.view(height, width), BESIDE) > 0


def _patterned(
    colours: Float[Tensor, "4 height width"],
) -> Bool[Tensor, "height width"]:
    """Where colours differ around a pixel, or nothing is known of them."""
    radius = max(1, round(AROUND * max(colours.shape[1:])))
    known, colours = colours[3:], colours[:3]
    stacked = torch.cat((colours, colours.square(), known))
    sums = F.avg_pool2d(stacked[None], 2 * radius + 1, 1, radius)[0]
    mean, square, share = sums.split((3, 3, 1))
    mean, square = mean / share.clamp(min=1e-6), square / share.clamp(min=1e-6)
    spread = (square - mean.square()).clamp(min=0).mean(0)
    return (spread > BLANK**2) | (share[0] == 0)
