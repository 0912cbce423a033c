"""Guessed depth that would stand, seen from between two photos, before what they measured."""

from collections.abc import Iterator
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.kit.geometry.cameras import project_to_pixels, unproject
from edit3r.kit.geometry.paths import interpolate_poses
from edit3r.kit.geometry.warping import nearest_views

# The numbers of this block: docs/notes/simplify.md.
ON_THE_WAY = (0, 0.25, 0.5, 0.75, 1)  # from one photo to the other, these included
BEFORE = 0.03  # share of a surface's depth from which a guess stands before it
STEP, STEPS = 1.05, 10  # by which depths grow: what hides something at the end stays
NEIGHBOURS = 2  # of each photo

Place = tuple[Float[Tensor, "4 4"], Float[Tensor, "height width"]]
"""A camera's pose, and the camera z of the nearest measured surface within a pixel; else infinity.
"""


@torch.no_grad()
def pushed_back(
    geometry: Geometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Geometry:
    """The geometry with guesses farther away, where they hid measured surfaces of their own photo
    and a neighbour from a camera on the way between these two.

    At its own photo a guess looks alike at any depth.
    """
    depths = geometry.depths.clone()
    for scene in range(len(depths)):
        own, lens = geometry.scene(scene), intrinsics[scene]
        for pair in _pairs(own):
            places = list(_between(pair, own, lens))
            for view in pair:
                depths[scene, view] = _behind(
                    depths[scene, view],
                    own.confidence[0, view] < 0.5,
                    lens[view],
                    own.c2w[0, view],
                    places,
                )
    return replace(geometry, depths=depths)


def _pairs(scene: Geometry) -> list[tuple[int, int]]:
    """Each placed view with its nearest ones."""
    placed = scene.registered[0].tolist()
    rows = nearest_views(scene.c2w, scene.depths, NEIGHBOURS)
    pairs = {
        (min(view, other), max(view, other))
        for view, row in enumerate(rows)
        for other in row
        if placed[view] and placed[other]
    }
    return sorted(pairs)


def _between(
    pair: tuple[int, int], scene: Geometry, intrinsics: Float[Tensor, "view 3 3"]
) -> Iterator[Place]:
    """Cameras on the way between two views, and what is measured of both as they see it."""
    views = list(pair)
    sure = scene.confidence[0, views] >= 0.5
    c2w = scene.c2w[0, views]
    points = unproject(scene.depths[0, views], intrinsics[views], c2w)[sure]
    height, width = sure.shape[1:]
    for share in ON_THE_WAY:
        start, end = c2w.double()
        pose = interpolate_poses(start, end, start.new_tensor(share)).to(c2w)
        index, z, inside = project_to_pixels(
            points, intrinsics[pair[0]], pose, (height, width)
        )
        nearest = torch.full((height * width,), torch.inf).to(z)
        nearest.scatter_reduce_(0, index[inside], z[inside], "amin")
        nearest = nearest.view(1, height, width)
        yield pose, -F.max_pool2d(-nearest, 3, 1, 1)[0]


def _behind(
    depths: Float[Tensor, "height width"],
    guessed: Bool[Tensor, "height width"],
    intrinsics: Float[Tensor, "3 3"],
    c2w: Float[Tensor, "4 4"],
    places: list[Place],
) -> Float[Tensor, "height width"]:
    """Depths of a view, of which the `guessed` hide nothing from any of the places."""
    result = depths.clone()
    rays = unproject(torch.ones_like(depths), intrinsics, c2w) - c2w[:3, 3]
    left, factor, size = guessed, 1.0, (depths.shape[0], depths.shape[1])
    for _ in range(STEPS):
        points = c2w[:3, 3] + rays[left] * (factor * depths[left])[:, None]
        hides = torch.zeros(len(points), dtype=torch.bool, device=depths.device)
        for pose, nearest in places:
            index, z, inside = project_to_pixels(points, intrinsics, pose, size)
            surface = nearest.flatten()[index[inside]]
            before = z[inside] < (1 - BEFORE) * surface
            hides[inside] |= surface.isfinite() & before
        free = left.clone()
        free[left] = ~hides
        result[free] = factor * depths[free]
        left = left & ~free
        factor *= STEP
    return result
