"""Poses and depth of the unedited photos: found once, before anything is selected, and shared."""

from dataclasses import dataclass, replace
from itertools import combinations, permutations

import cv2
import numpy as np
from jaxtyping import Float

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import Geometry, Matcher
from edit3r.contract.reporting import warn
from edit3r.contract.types import Views
from edit3r.kit.checks import check_geometry, errors_named_after
from edit3r.kit.geometry.cameras import pixel_grid, project, unproject
from edit3r.loading.registry import Registry
from edit3r.running.config import RunConfig

MIN_MOTION = 0.004
"""How far measured points must move from photo to photo for depth to mean anything [long sides]."""
ON_ONE_PLANE = 0.6 / 256
"""How far points may lie from where one homography brings them [long sides]; photos of things in
depth miss it ten times as far.
"""
NEARLY_ALL = 0.9  # share of the measured points that lie so
MOST_POINTS = 2000  # that are tried
STOOD_STILL = (
    "the photos were taken from nearly the same place, so nothing tells near from far; move "
    "aside between photos"
)


@dataclass(frozen=True, eq=False)
class Located:
    """What a matcher found of the photos, and why it is not to be selected by, if so."""

    geometry: Geometry | None  # None: nobody looked, or it could not be found
    problem: str = ""  # a clause; "": the geometry can be trusted

    def told(self) -> Geometry | None:
        """The geometry where it can be trusted; where it cannot, the user is told."""
        if self.problem:
            warn(f"selecting goes by what the photos show alone: {self.problem}")
            return None
        return self.geometry


def locate(matcher: Matcher | None, views: Views) -> Located:
    """What `matcher` reads from unedited photos; nothing without one, or for a single photo."""
    if matcher is None or views.count < 2:
        return Located(None)
    try:
        with errors_named_after(matcher, views.images):
            geometry = matcher.match(views)
    except MatchingError as error:
        return Located(None, str(error))
    check_geometry(matcher, views, geometry)
    return Located(geometry, "" if _has_depth(geometry, views) else STOOD_STILL)


def default_matcher(registry: Registry) -> Matcher | None:
    """The matcher of the reconstructor that a run takes unasked, so that both find the same."""
    usual = RunConfig.model_fields["reconstructor"].default
    choice = getattr(registry.check("reconstructor", usual), "matcher", None)
    return choice and registry.build_choice("matcher", choice)


def _has_depth(geometry: Geometry, views: Views) -> bool:
    """Whether, in every scene, photos were taken from places that lie apart.

    Where a camera stood still and somebody moved, poses are read from what moved: nearly all else
    is measured, and lies where it lay, at any depth.
    """
    return all(
        any(
            _motion(of_scene(geometry, scene), views.scene(scene), *pair) > MIN_MOTION
            for pair in permutations(range(views.count), 2)
            if geometry.registered[scene, list(pair)].all()
        )
        for scene in range(len(views.images))
    )


def _motion(geometry: Geometry, views: Views, view: int, other: int) -> float:
    """How far the middle one of all measured points of `view` lies elsewhere in `other`."""
    here, there = _places(geometry, views, view, other)
    return float(np.median(np.linalg.norm(there - here, axis=1))) if len(here) else 0.0


def lies_flat(geometry: Geometry | None, views: Views) -> bool:
    """Whether one homography explains all that any two photos of the first scene share.

    So it is for a flat thing, and where the camera only turned. Neither tells the lens, and with a
    wrong one a motion is invented where there was none.
    """
    if geometry is None:
        return False
    first, photos = of_scene(geometry, 0), views.scene(0)
    pairs = [
        pair
        for pair in combinations(range(views.count), 2)
        if geometry.registered[0, list(pair)].all()
    ]
    return bool(pairs) and all(
        _on_one_plane(*_places(first, photos, *pair)) for pair in pairs
    )


def _on_one_plane(
    here: Float[np.ndarray, "point 2"], there: Float[np.ndarray, "point 2"]
) -> bool:
    chosen = np.linspace(0, len(here) - 1, min(len(here), MOST_POINTS)).astype(int)
    here, there = here[chosen], there[chosen]
    inside = (np.abs(there - 0.5) < 0.5).all(1)
    if inside.sum() < 8:
        return False
    cv2.setRNGSeed(0)
    _, kept = cv2.findHomography(here[inside], there[inside], cv2.RANSAC, ON_ONE_PLANE)
    return kept is not None and float(kept.mean()) >= NEARLY_ALL


def _places(
    geometry: Geometry, views: Views, view: int, other: int
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point 2"]]:
    """Where the measured points of `view` lie in it, and in `other` [long sides]."""
    lens = geometry.calibrated(views).intrinsics
    measured = geometry.confidence[0, view] >= 0.5
    depths = geometry.depths[0, view]
    points = unproject(depths, lens[0, view], geometry.c2w[0, view])[measured]
    there, _ = project(points, lens[0, other], geometry.c2w[0, other])
    height, width = depths.shape
    here = pixel_grid((height, width), like=depths)[measured]
    sides = here.new_tensor([width, height]) / max(height, width)
    return (here * sides).numpy(force=True), (there * sides).numpy(force=True)


def geometry_of(matcher: Matcher | None, views: Views) -> Geometry | None:
    """The geometry of the photos to select by; None, and said so, where it cannot be trusted."""
    return locate(matcher, views).told()


def of_scene(geometry: Geometry, index: int) -> Geometry:
    """The geometry of one scene of a batch, as a batch of one."""
    one = slice(index, index + 1)
    lens = geometry.intrinsics
    return replace(
        geometry,
        c2w=geometry.c2w[one],
        depths=geometry.depths[one],
        confidence=geometry.confidence[one],
        registered=geometry.registered[one],
        intrinsics=None if lens is None else lens[one],
    )
