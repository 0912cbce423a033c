"""Poses and depths of photos: who reads them, and whether they can be trusted."""

from dataclasses import dataclass, replace
from itertools import combinations, permutations

import cv2
import numpy as np
from jaxtyping import Float

from edit3r.contract.errors import MatchingError
from edit3r.contract.interfaces import (
    FindsGeometry,
    Geometry,
    Matcher,
    Reconstructor,
)
from edit3r.contract.reporting import warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit import asking
from edit3r.kit.geometry.cameras import pixel_grid, project, unproject
from edit3r.loading.registry import Registry
from edit3r.running.config import DEFAULTS

MIN_MOTION = 0.004
"""How far measured points must move for depth to mean anything [long sides]; no figure kept."""
ON_ONE_PLANE = 0.6 / 256
"""How far points may lie from where one homography brings them [long sides]; photos of things in
depth miss it ten times as far. No figure kept.
"""
NEARLY_ALL = 0.9  # share of the measured points that lie so; no figure kept
MOST_POINTS = 2000  # that are tried
STOOD_STILL = (
    "the photos were taken from nearly the same place, so nothing tells near from far; move "
    "aside between photos"
)


Source = Matcher | FindsGeometry
"""Who reads the geometry of a run: its matcher, or a reconstructor that finds it by itself."""


@dataclass(frozen=True, eq=False)
class GeometryAnswer:
    """The geometry of photos, and why it is not to be selected by, if so."""

    geometry: Geometry | None  # None: nobody looked, or the photos could not be placed
    problem: str = ""  # a clause; "": the geometry can be trusted

    def required(self) -> Geometry:
        """The geometry; raises MatchingError where the photos could not be placed."""
        if self.geometry is None:
            raise MatchingError(self.problem)
        return self.geometry

    def trusted(self) -> Geometry | None:
        """The geometry to select by; where it cannot be trusted, the user is told why."""
        if self.problem:
            warn(
                "only what the photos show is used to select, not where they were taken: "
                f"{self.problem}"
            )
            return None
        return self.geometry

    def select(self, indices: list[int]) -> "GeometryAnswer":
        """The same with the views at `indices` only."""
        if self.geometry is None:
            return self
        return replace(self, geometry=self.geometry.select(indices))


NOT_ASKED = GeometryAnswer(None)


def find_geometry(
    source: Source, views: Views, corrected: Views | None = None
) -> GeometryAnswer:
    """The geometry of `views`, or why they cannot be placed. `corrected`: the same photos in one
    exposure, on which depth is measured where the matcher can do that.
    """
    try:
        geometry = asking.find_geometry(source, views, corrected)
    except MatchingError as error:
        return GeometryAnswer(None, str(error))
    return GeometryAnswer(geometry, "" if _has_depth(geometry, views) else STOOD_STILL)


def uses_geometry(reconstructor: Reconstructor) -> bool:
    """Whether its scene stands on the geometry of the run: read by a matcher, or by itself."""
    return reconstructor.uses_geometry or isinstance(reconstructor, FindsGeometry)


def default_matcher(registry: Registry) -> Matcher:
    """The matcher that a run takes unasked, so that both find the same."""
    return registry.build_choice("matcher", usual_choice())


def usual_choice() -> PartChoice:
    """The matcher of photos whose poses nobody knows, and its settings."""
    return PartChoice.model_validate(DEFAULTS["matcher"])


def _has_depth(geometry: Geometry, views: Views) -> bool:
    """Whether, in every scene, photos were taken from places that lie apart.

    Where a camera stood still and somebody moved, poses are read from what moved: nearly all else
    is measured, and lies where it lay, at any depth.
    """
    return all(
        any(
            _motion(geometry.scene(scene), views.scene(scene), *pair) > MIN_MOTION
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
    first, photos = geometry.scene(0), views.scene(0)
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
    _, inliers = cv2.findHomography(
        here[inside], there[inside], cv2.RANSAC, ON_ONE_PLANE
    )
    return inliers is not None and float(inliers.mean()) >= NEARLY_ALL


def _places(
    geometry: Geometry, views: Views, view: int, other: int
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, "point 2"]]:
    """Where the measured points of `view` lie in it, and in `other` [long sides]."""
    lens = geometry.calibrated(views).intrinsics
    measured = geometry.is_measured[0, view]
    depths = geometry.depths[0, view]
    points = unproject(depths, lens[0, view], geometry.c2w[0, view])[measured]
    there, _ = project(points, lens[0, other], geometry.c2w[0, other])
    height, width = depths.shape
    here = pixel_grid((height, width), like=depths)[measured]
    sides = here.new_tensor([width, height]) / max(height, width)
    return (here * sides).numpy(force=True), (there * sides).numpy(force=True)


def geometry_answer(matcher: Source, views: Views) -> GeometryAnswer:
    """The geometry of the photos, or why they cannot be placed; of one photo there is none."""
    return find_geometry(matcher, views) if views.count > 1 else NOT_ASKED


def geometry_of(matcher: Matcher, views: Views) -> Geometry | None:
    """The geometry of the photos to select by; None, and said so, where it cannot be trusted."""
    return geometry_answer(matcher, views).trusted()
