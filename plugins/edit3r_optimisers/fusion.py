"""Fuse the edits of neighbouring views into a view through the fitted geometry.

EditSplat's multi-view fusion (Lee et al. 2025, section 3.2) projects edited neighbours into a view by depth and blends
them. Its choice of neighbours by ImageReward and its background by SAM need weights; here the nearest views count,
each weighted by how exactly its surface is the one seen.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject
from edit3r.types import Cameras

__all__ = ["Fused", "fuse", "nearest_views"]

DEPTH_TOLERANCE = 0.03
"""Relative difference of depths at which a neighbour's weight has fallen to exp(-1/2): it sees another surface."""
OWN_WEIGHT = 0.25
"""Of the view's own edit beside its neighbours' weights of up to 1 each; it alone counts where no neighbour looks."""


@dataclass(frozen=True)
class Fused:
    """What all views together say of one."""

    image: Float[Tensor, "3 height width"]
    support: Float[Tensor, "height width"]  # summed weights of the neighbours; 0: only the view's own edit


def fuse(
    view: int,
    neighbours: list[int],
    edits: Float[Tensor, "view 3 height width"],
    depths: Float[Tensor, "view height width"],
    cameras: Cameras,
) -> Fused:
    """The edits of `neighbours` seen from `view`, blended with its own; `depths` are camera z of the fitted scene."""
    points = unproject(depths[view], cameras.intrinsics[0, view], cameras.c2w[0, view]).flatten(0, 1)
    total, weights = OWN_WEIGHT * edits[view], torch.full_like(depths[view], OWN_WEIGHT)
    for other in neighbours:
        colours, weight = _seen_from(points, edits[other], depths[other], cameras.select([other]))
        total, weights = total + weight * colours, weights + weight
    return Fused(total / weights, weights - OWN_WEIGHT)


def nearest_views(cameras: Cameras, view: int, count: int) -> list[int]:
    """The `count` views whose cameras stand nearest, nearest first."""
    centres = cameras.c2w[0, :, :3, 3]
    order = (centres - centres[view]).norm(dim=-1).argsort(stable=True).tolist()
    return [other for other in order if other != view][:count]


def _seen_from(
    points: Float[Tensor, "point 3"],
    edit: Float[Tensor, "3 height width"],
    depth: Float[Tensor, "height width"],
    camera: Cameras,
) -> tuple[Float[Tensor, "3 height width"], Float[Tensor, "height width"]]:
    """What one neighbour shows at the points of another view's pixels, and how far that can be believed."""
    places, z = project(points, camera.intrinsics[0, 0], camera.c2w[0, 0])
    size = depth.shape
    grid = (2 * places - 1).view(1, *size, 2)  # grid_sample counts from -1 to 1
    sampled = F.grid_sample(torch.cat((edit, depth[None]))[None], grid, align_corners=False, padding_mode="border")[0]
    inside = (z > 0) & ((places >= 0) & (places <= 1)).all(-1)
    off = (sampled[3] - z.view(size)) / (DEPTH_TOLERANCE * z.view(size).abs().clamp(min=1e-9))
    return sampled[:3], torch.exp(-0.5 * off.square()) * inside.view(size)
