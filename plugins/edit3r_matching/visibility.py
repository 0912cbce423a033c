"""What the other views say of a pixel: whether they show its place, and whether they contradict its depth."""

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject
from edit3r.interfaces import MatchedGeometry

__all__ = ["floats_in_front", "shown_by", "shown_elsewhere"]

_MARGIN = 0.03
"""Relative difference in depth by which a pixel must stand before a surface to hide it."""


def floats_in_front(
    geometry: MatchedGeometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Bool[Tensor, "batch view height width"]:
    """Guessed pixels (confidence below 0.5) that would stand before a surface that another view measured."""
    points = unproject(geometry.depths, intrinsics, geometry.c2w)
    guessed = geometry.confidence < 0.5
    floating = torch.zeros_like(guessed)
    views = geometry.depths.shape[1]
    for view in range(views):
        for other in range(views):
            if other != view:
                hides = _before(points[:, view], geometry, intrinsics, other)
                hides &= geometry.registered[:, other, None, None]
                floating[:, view] |= hides
    return floating & guessed


def shown_elsewhere(
    geometry: MatchedGeometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Bool[Tensor, "batch view height width"]:
    """Pixels whose place lies in the picture of another registered view, hidden there or not."""
    points = unproject(geometry.depths, intrinsics, geometry.c2w).flatten(2, 3)
    shown = torch.zeros(points.shape[:3], dtype=torch.bool, device=points.device)
    views = geometry.depths.shape[1]
    for view in range(views):
        for other in range(views):
            if other != view:
                shown[:, view] |= shown_by(points[:, view], geometry, intrinsics, other)
    return shown.view(geometry.depths.shape)


def shown_by(
    points: Float[Tensor, "batch point 3"],
    geometry: MatchedGeometry,
    intrinsics: Float[Tensor, "batch view 3 3"],
    view: int,
) -> Bool[Tensor, "batch point"]:
    """Points that lie in the picture of `view`, hidden there or not; none where it is not registered."""
    places, depth = project(points, intrinsics[:, view], geometry.c2w[:, view])
    return ((places > 0) & (places < 1)).all(-1) & (depth > 0) & geometry.registered[:, view, None]


def _before(
    points: Float[Tensor, "batch height width 3"],
    geometry: MatchedGeometry,
    intrinsics: Float[Tensor, "batch view 3 3"],
    other: int,
) -> Bool[Tensor, "batch height width"]:
    """Points that stand before what view `other` measured along the same ray."""
    batch, height, width = points.shape[:3]
    places, depth = project(points.flatten(1, 2), intrinsics[:, other], geometry.c2w[:, other])
    grid = (2 * places - 1).view(batch, height, width, 2)
    seen = torch.stack((geometry.depths[:, other], geometry.confidence[:, other]), 1)
    seen = F.grid_sample(seen, grid, mode="nearest", padding_mode="zeros", align_corners=False)
    depth = depth.view(batch, height, width)
    return (depth > 0) & (seen[:, 1] > 0.5) & (depth < (1 - _MARGIN) * seen[:, 0])
