"""What the other views say about a pixel: whether they show its point, and whether they contradict its depth."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import project, unproject
from edit3r.geometry.warping import warp
from edit3r.interfaces import MatchedGeometry

__all__ = ["in_front_of_others", "seen_by", "seen_by_others"]

TOLERANCE = 0.03
"""Relative difference in depth by which a pixel must stand before a surface to hide it."""


def in_front_of_others(
    geometry: MatchedGeometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Bool[Tensor, "batch view height width"]:
    """Guessed pixels (confidence below 0.5) that would hide a surface that another registered view measured."""
    points = unproject(geometry.depths, intrinsics, geometry.c2w)
    guessed = geometry.confidence < 0.5
    hiding = torch.zeros_like(guessed)
    views = geometry.depths.shape[1]
    for view in range(views):
        for other in range(views):
            if other != view:
                hides = _hides(points[:, view], geometry, intrinsics, other)
                hiding[:, view] |= hides & geometry.registered[:, other, None, None]
    return hiding & guessed


def seen_by_others(
    geometry: MatchedGeometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Bool[Tensor, "batch view height width"]:
    """Pixels whose point lies within the image of another registered view, whether hidden there or not."""
    points = unproject(geometry.depths, intrinsics, geometry.c2w).flatten(2, 3)
    seen = torch.zeros(points.shape[:3], dtype=torch.bool, device=points.device)
    views = geometry.depths.shape[1]
    for view in range(views):
        for other in range(views):
            if other != view:
                seen[:, view] |= seen_by(points[:, view], geometry, intrinsics, other)
    return seen.view(geometry.depths.shape)


def seen_by(
    points: Float[Tensor, "batch point 3"],
    geometry: MatchedGeometry,
    intrinsics: Float[Tensor, "batch view 3 3"],
    view: int,
) -> Bool[Tensor, "batch point"]:
    """World points that lie within the image of `view`, whether hidden there or not; none if it is not registered."""
    coordinates, depth = project(points, intrinsics[:, view], geometry.c2w[:, view])
    return ((coordinates > 0) & (coordinates < 1)).all(-1) & (depth > 0) & geometry.registered[:, view, None]


def _hides(
    points: Float[Tensor, "batch height width 3"],
    geometry: MatchedGeometry,
    intrinsics: Float[Tensor, "batch view 3 3"],
    other: int,
) -> Bool[Tensor, "batch height width"]:
    """World points that stand before what view `other` measured along the same ray."""
    coordinates, depth = project(points.flatten(1, 2), intrinsics[:, other], geometry.c2w[:, other])
    measured = torch.stack((geometry.depths[:, other], geometry.confidence[:, other]), 1)
    seen = warp(measured, coordinates.view(*points.shape[:3], 2), mode="nearest", padding="zeros")
    depth = depth.view(points.shape[:3])
    return (depth > 0) & (seen[:, 1] > 0.5) & (depth < (1 - TOLERANCE) * seen[:, 0])
