"""Where points of a view lie in other views: warped images, what hides what."""

from itertools import permutations

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry
from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.maps import dilate

__all__ = [
    "SAME_SURFACE",
    "contradicted",
    "nearest_views",
    "seen_by",
    "shared_surface",
    "stands_before_others",
    "surfaces_apart",
    "warp",
]

TOLERANCE = 0.03
SAME_SURFACE = 0.05
"""Relative difference of depths within which two views usually show one surface."""
"""Relative difference in depth by which a pixel must stand before a surface to hide it; below, it
shows it too. No figure kept.
"""


LITTLE_MEASURED = 0.5
"""Share of a view that was measured, below which its guesses count less than what others show."""
CLEARLY_MORE = 0.15
"""By how much more another view must have measured [share of its pixels].
See docs/notes/classical.md.
"""
NEAR_VIEWS = 12
"""Others that tell of each view's pixels which ones they contradict: asking all of many views takes
time with the square of their number.
"""


# < 0: floats in front of what the partner sees; > 0: hidden behind it


def warp(
    images: Float[Tensor, "*batch channel height width"],
    coordinates: Float[Tensor, "*batch height2 width2 2"],
    mode: str = "bilinear",
    padding: str = "border",
) -> Float[Tensor, "*batch channel height2 width2"]:
    """Sample `images` at normalised `coordinates` (x, y); pixel centres as in `cameras.pixel_grid`.

    `mode` (such as 'nearest') and `padding` (such as 'border', which repeats the edge) are those of
    `F.grid_sample`.
    """
    flat = images.reshape(-1, *images.shape[-3:])
    grid = coordinates.reshape(-1, *coordinates.shape[-3:]) * 2 - 1
    sampled = F.grid_sample(
        flat, grid, mode=mode, padding_mode=padding, align_corners=False
    )
    return sampled.reshape(*images.shape[:-2], *coordinates.shape[-3:-1])


def contradicted(
    geometry: Geometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Bool[Tensor, "batch view height width"]:
    """Pixels that other registered views show better or see through.

    Guesses (confidence below 0.5) on or before a surface that another view measured, and measured
    pixels that more views see through than confirm; of three views and more also guesses of a
    mostly guessed one, at places that another shows of which clearly more was measured. Of many
    views, the nearest are asked.
    """
    points = unproject(geometry.depths, intrinsics, geometry.c2w)
    guessed = geometry.confidence < 0.5
    better = _better_measured(geometry)
    surfaces = geometry.depths * (~guessed & geometry.registered[..., None, None])
    # at a depth edge neither of two surfaces is seen through
    nearest = -dilate(-surfaces, 1)
    through, confirmed = (
        torch.zeros_like(guessed, dtype=torch.int16) for _ in range(2)
    )
    nearest_others = nearest_views(geometry.c2w, geometry.depths, NEAR_VIEWS)
    for view, other in ((a, b) for a, row in enumerate(nearest_others) for b in row):
        grid, seen, z = _seen_there(
            points[:, view],
            surfaces[:, other],
            intrinsics[:, other],
            geometry.c2w[:, other],
        )
        close = warp(nearest[:, other, None], grid, mode="nearest", padding="zeros")
        close = close[:, 0]
        edge = torch.where(guessed[:, view], seen, close)
        through[:, view] += (z > 0) & (z < (1 - TOLERANCE) * edge)
        confirmed[:, view] += (z > 0) & ((z - seen).abs() <= TOLERANCE * seen)
        shown = (z > 0) & ((grid > 0) & (grid < 1)).all(-1) & guessed[:, view]
        confirmed[:, view] += shown & better[:, view, other, None, None]
    return torch.where(guessed, through + confirmed > 0, through > confirmed)


def _better_measured(geometry: Geometry) -> Bool[Tensor, "batch view view"]:
    """For each view that is mostly guessed the others of which clearly more was measured; none of
    two: what one of them guesses, nobody else shows.
    """
    share = geometry.measured * geometry.registered
    own, other = share[:, :, None], share[:, None]
    several = geometry.registered.sum(1)[:, None, None] > 2
    return several & (own < LITTLE_MEASURED) & (other > own + CLEARLY_MORE)


def nearest_views(
    c2w: Float[Tensor, "batch view 4 4"],
    depths: Float[Tensor, "batch view height width"],
    most: int,
) -> list[list[int]]:
    """For each view the at most `most` others whose cameras, and what they look at, are nearest."""
    count = c2w.shape[1]
    if count - 1 <= most:
        return [
            [other for other in range(count) if other != view] for view in range(count)
        ]
    ahead = depths.flatten(2).median(-1).values[..., None]
    centres = c2w[..., :3, 3]
    targets = centres + ahead * c2w[..., :3, 2]
    apart = (torch.cdist(centres, centres) + torch.cdist(targets, targets)).sum(0)
    apart.fill_diagonal_(torch.inf)
    return apart.argsort(dim=1, stable=True)[:, :most].sort(1).values.tolist()


def stands_before_others(
    points: Float[Tensor, "batch view rows columns 3"],
    surfaces: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    c2w: Float[Tensor, "batch view 4 4"],
) -> Bool[Tensor, "batch view rows columns"]:
    """World points of each view that would hide what another view shows (0: nothing).

    `surfaces` are the camera z of what each view shows.
    """
    hides = torch.zeros(points.shape[:4], dtype=torch.bool, device=points.device)
    for view, other in permutations(range(points.shape[1]), 2):
        _, seen, z = _seen_there(
            points[:, view], surfaces[:, other], intrinsics[:, other], c2w[:, other]
        )
        hides[:, view] |= (z > 0) & (z < seen)
    return hides


def shared_surface(
    depths: Float[Tensor, "2 height width"],
    intrinsics: Float[Tensor, "2 3 3"],
    c2w: Float[Tensor, "2 4 4"],
    tolerance: float = TOLERANCE,
) -> tuple[Float[Tensor, "height width 2"], Bool[Tensor, "height width"]]:
    """Where the pixels of the first view lie in the second; whether both show one surface.

    `depths` are camera z (0: none); `tolerance` is the relative difference in depth within which
    it is one surface.
    """
    coordinates, apart = surfaces_apart(depths, intrinsics, c2w)
    return coordinates, apart < tolerance


def surfaces_apart(
    depths: Float[Tensor, "2 height width"],
    intrinsics: Float[Tensor, "2 3 3"],
    c2w: Float[Tensor, "2 4 4"],
) -> tuple[Float[Tensor, "height width 2"], Float[Tensor, "height width"]]:
    """Where the pixels of the first view lie in the second, and the relative difference of their
    depth from what that one shows there; infinite where one of them shows nothing.
    """
    points = unproject(depths[:1], intrinsics[:1], c2w[:1])
    coordinates, seen, z = _seen_there(points, depths[1:], intrinsics[1:], c2w[1:])
    apart = (z / seen.clamp(min=1e-9) - 1).abs()
    return coordinates[0], torch.where((z > 0) & (seen > 0), apart, torch.inf)[0]


def _seen_there(
    points: Float[Tensor, "batch rows columns 3"],
    surface: Float[Tensor, "batch height width"],
    intrinsics: Float[Tensor, "batch 3 3"],
    c2w: Float[Tensor, "batch 4 4"],
) -> tuple[Tensor, Float[Tensor, "batch rows columns"], Tensor]:
    """Where world points lie in a view, the camera z it shows there (0: none), and theirs."""
    coordinates, z = project(points.flatten(1, 2), intrinsics, c2w)
    grid = coordinates.unflatten(1, points.shape[1:3])
    seen = warp(surface[:, None], grid, mode="nearest", padding="zeros")[:, 0]
    return grid, seen, z.view_as(seen)


def seen_by(
    points: Float[Tensor, "batch point 3"],
    geometry: Geometry,
    intrinsics: Float[Tensor, "batch view 3 3"],
    view: int,
) -> Bool[Tensor, "batch point"]:
    """World points within the image of `view`, hidden or not; none if not registered."""
    coordinates, depth = project(points, intrinsics[:, view], geometry.c2w[:, view])
    return (
        ((coordinates > 0) & (coordinates < 1)).all(-1)
        & (depth > 0)
        & geometry.registered[:, view, None]
    )
