"""Skill: how much better a scene brings one photo onto another than the cheapest scene, one flat
picture, and how much worse than the depths and poses do that it was made of.

Each photo shows itself perfectly whatever stands behind its own Gaussians. So photo B is laid onto
its neighbour A in three ways: by the best homography, by the depths and poses that the run found
itself, and by those of the scene: of A's own Gaussians, since those of B may hide that they are
wrong; of all that the rasterizer shows where nobody knows whose a Gaussian is. Only colours of the
photos are compared, whatever the edit did.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry, SceneToJudge
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.kit.geometry.cameras import (
    project,
    project_to_pixels,
    unproject,
)
from edit3r.kit.geometry.exposure import estimate_exposure
from edit3r.kit.geometry.maps import dilate, size_of
from edit3r.kit.geometry.warping import warp
from edit3r.kit.photos.images import evenly
from edit3r_judge.signals import SIDE, blurred, homography_grid, lab, small

# The numbers of this block: chosen by hand before any limit was fitted (docs/notes/verdict.md).
MOST = 24.0  # difference of colours from which it is another thing [CIE Lab]
FLOOR = 2.0  # that noise and light alone make [CIE Lab]
FEW = 0.02  # share of the picture below which nothing is told
BEHIND = 0.01  # relative depth from which a solid Gaussian stands behind a faint one
SHOWN = 0.8  # opacity from which the scene shows a surface
KEPT = 0.02  # difference of colours [sRGB] from which an edit changed a pixel
OWN = 0.2  # share of a photo that its own Gaussians show, below which all are asked
MOST_PAIRS = 8  # of photos that are compared
MATCHES = 30  # below which photos do not tell who is wrong
FLAT = 0.9  # share of the matches that one homography explains, where the photos show a plane
# These two by hand after that (2026-11-30; the same page).
# difference that one of two ways must leave to tell them apart [CIE Lab]: near the floor sound
# depths are no better than one flat picture
DISCERNIBLE = 2.5
# share of the photos without an edit, from which the rest is not looked at
LEFT_ALONE = 0.2

Picture = Float[Tensor, "channel height width"]
Places = Float[Tensor, "height width 2"]
Matches = tuple[Float[np.ndarray, "match 2"], Float[np.ndarray, "match 2"]]


@dataclass(frozen=True)
class Skill:
    """Of a photo beside the nearest one; differences are means over what all three ways show."""

    view: int
    scene: float  # difference that is left, by the scene [CIE Lab]
    geometry: float | None  # by the run's geometry
    # by a homography; None: the photos show one plane, or too little
    flat: float | None

    @property
    def beside_geometry(self) -> float | None:
        """How many times as much the scene leaves; 1: it is as good."""
        if self.geometry is None:
            return None
        return max(self.scene, FLOOR) / max(self.geometry, FLOOR)

    @property
    def beside_flat(self) -> float | None:
        """What the run's geometry, or a scene without any, leaves as a share of what one flat
        picture does; 1: there is no depth. None where both leave next to nothing.
        """
        left = self.scene if self.geometry is None else self.geometry
        if self.flat is None or max(left, self.flat) < DISCERNIBLE:
            return None
        return max(left, FLOOR) / max(self.flat, FLOOR)


def skills(scene: SceneToJudge) -> list[Skill]:
    """Of each placed photo that has a neighbour, both ways; of a batch the first scene counts."""
    if scene.half_way is None:
        return []
    photos = _Photos(_on_cpu(scene))
    # what is broken is broken in most photos
    pairs = evenly(scene.half_way.pairs, MOST_PAIRS)
    both = [way for pair in pairs for way in (pair, pair[::-1])]
    return [one for one in (photos.skill(*way) for way in both) if one is not None]


def _on_cpu(scene: SceneToJudge) -> SceneToJudge:
    """What is compared, where OpenCV can read it."""
    return replace(
        scene,
        photos=scene.photos.to("cpu"),
        edited=scene.edited.to("cpu"),
        geometry=None if scene.geometry is None else scene.geometry.to("cpu"),
        first=scene.first.to("cpu"),
        cameras=scene.cameras.to("cpu"),
        gaussians=scene.gaussians.to("cpu"),
    )


class _Photos:
    """The placed photos, and what the scene and the run's geometry say of their depths."""

    def __init__(self, scene: SceneToJudge) -> None:
        used = [view for view, there in enumerate(scene.placed) if there]
        views = scene.photos.scene(0).select(used)
        geometry = scene.geometry
        if geometry is not None:
            geometry = geometry.scene(0).select(used)
        self.pictures = blurred(lab(_in_one_light(views, geometry)), 1)
        self.size = size_of(self.pictures)
        self.same = unchanged(scene)
        self.gaussians, self.cameras = scene.gaussians, scene.cameras.at(self.size)
        self.shown = _sampled(scene.first.depths[0, :, 0], self.size)
        self.shown[small(scene.first.alphas[0, :, 0]) < SHOWN] = 0
        self.marks, self.depths = cache(self._marks), cache(self._depths)
        self._found: dict[tuple[int, int], Matches] = {}
        self.geometry = None
        if geometry is not None:
            lenses = geometry.calibrated(views).intrinsics
            cameras = Cameras(geometry.c2w, lenses, self.size)
            self.geometry = geometry.at(self.size).depths[0], cameras

    def _marks(self, view: int) -> tuple[Any, Any]:
        """SIFT features of a photo."""
        sift = cv2.SIFT_create(2000, contrastThreshold=0.015)  # type: ignore[attr-defined]
        light = (2.55 * self.pictures[view, 0].clamp(0, 100)).byte().numpy()
        return sift.detectAndCompute(light, None)

    def _depths(self, view: int) -> Float[Tensor, "height width"]:
        """What the scene says of a photo's depths; 0: nothing."""
        own = _depths_of(self.gaussians.from_view(view), self.cameras, view)
        return own if float((own > 0).float().mean()) > OWN else self.shown[view]

    def skill(self, view: int, other: int) -> Skill | None:
        """How well each way lays photo `other` onto photo `view`; None: they share too little."""
        own = self.depths(view)
        ways = {"scene": _places(own, self.cameras, view, other)}
        if self.geometry is not None:
            depths, cameras = self.geometry
            ways["geometry"] = _places(depths[view], cameras, view, other)
        where = own > 0
        for name, places in ways.items():
            if name != "scene":
                where &= _within(places)
        matches, unchanged = self._matches(view, other), self.same[view]
        kept = where & unchanged
        if float(kept.float().mean()) > LEFT_ALONE * float(where.float().mean()):
            where = kept  # what an edit took away or added is at no depth of the photos
            # whether the photos show one plane is asked of what is compared
            matches = _where(unchanged, matches)
        flat = _homography(*matches, self.size)
        if flat is not None:
            ways["flat"] = flat
            where &= _within(flat)
        if float(where.float().mean()) < FEW:
            return None
        left = {
            name: self._left(view, other, places, where)
            for name, places in ways.items()
        }
        return Skill(view, left["scene"], left.get("geometry"), left.get("flat"))

    def _matches(self, view: int, other: int) -> Matches:
        if (other, view) in self._found:
            return self._found[other, view][::-1]
        found = _matched(self.marks(view), self.marks(other))
        self._found[view, other] = found
        return found

    def _left(self, view: int, other: int, places: Places, where: Tensor) -> float:
        """The difference that is left; what leaves the other photo is another thing."""
        laid = warp(self.pictures[other], places)
        off = (laid - self.pictures[view]).norm(dim=0).clamp(max=MOST)
        off[~_within(places)] = MOST
        return float(off[where].mean())


def unchanged(scene: SceneToJudge, side: int = SIDE) -> Bool[Tensor, "view h w"]:
    """Pixels of the placed photos that the edit left as they were, `side` on the longer side."""
    photos = scene.photos.images[0, list(scene.placed)]
    changed = (scene.edited.images[0] - photos).abs().amax(1, keepdim=True)
    return (small(changed, side) < KEPT)[:, 0]


def _in_one_light(
    views: Views, geometry: Geometry | None
) -> Float[Tensor, "view 3 height width"]:
    """The photos in the exposure of the first one: else a brighter one looks like another thing."""
    if geometry is None:
        return views.images[0]
    light = estimate_exposure(geometry.calibrated(views), geometry)
    return (views.images if light is None else light.to_reference(views.images))[0]


def _within(places: Places) -> Bool[Tensor, "height width"]:
    """Which of them lie in the other photo."""
    return ((places > 0) & (places < 1)).all(-1)


def _where(inside: Bool[Tensor, "height width"], matches: Matches) -> Matches:
    """The matches whose place in the first photo, in pixels, is inside."""
    here, there = matches
    height, width = inside.shape
    column, row = here.astype(int).clip(0, (width - 1, height - 1)).T
    chosen = inside.numpy()[row, column]
    return here[chosen], there[chosen]


def _depths_of(
    gaussians: Gaussians, cameras: Cameras, view: int
) -> Float[Tensor, "height width"]:
    """Camera z of the nearest centre in and about each pixel of a photo; 0: there is none, or it is
    faint, as where another photo's Gaussians show what this one's do not.
    """
    solid = gaussians.select(gaussians.opacities[0] > 0.5)
    nearest, surface = (_nearest(one, cameras, view) for one in (gaussians, solid))
    shown = surface.isfinite() & (surface <= (1 + BEHIND) * nearest)
    return torch.where(shown, surface, 0.0)


def _nearest(
    gaussians: Gaussians, cameras: Cameras, view: int
) -> Float[Tensor, "height width"]:
    """Camera z of the nearest centre in and about each pixel of a photo; inf: there is none."""
    lens, c2w = cameras.intrinsics[0, view], cameras.c2w[0, view]
    size = cameras.image_size
    pixel, depth, inside = project_to_pixels(gaussians.means[0], lens, c2w, size)
    nearest = torch.full((size[0] * size[1],), torch.inf)
    nearest.scatter_reduce_(0, pixel[inside], depth[inside], "amin")
    nearest = nearest.view(size)
    about = -dilate(-nearest, 1)
    return torch.where(nearest.isfinite(), nearest, about)


def _places(
    depths: Float[Tensor, "height width"], cameras: Cameras, view: int, other: int
) -> Places:
    """Where in photo `other` each pixel of photo `view` lies, normalised; beside it, at -1, what is
    behind its camera.
    """
    pair = [view, other]
    lenses, c2w = cameras.intrinsics[0, pair], cameras.c2w[0, pair]
    points = unproject(depths, lenses[0], c2w[0])
    places, z = project(points.flatten(0, 1), lenses[1], c2w[1])
    places[(z <= 0) | ~places.isfinite().all(-1)] = -1
    return places.view(*depths.shape, 2)


def _homography(
    here: Float[np.ndarray, "match 2"],
    there: Float[np.ndarray, "match 2"],
    size: tuple[int, int],
) -> Places | None:
    """Where the best homography brings each pixel, normalised; None where it explains nearly all
    that the two share (a flat thing, a camera that only turned), or they share too little.
    """
    if len(here) < MATCHES:
        return None
    cv2.setRNGSeed(0)
    matrix, inliers = cv2.findHomography(here, there, cv2.RANSAC, 3.0)
    if matrix is None or inliers.mean() >= FLAT:
        return None
    return homography_grid(matrix, size).float()


def _matched(marks: tuple[Any, Any], marks_there: tuple[Any, Any]) -> Matches:
    """Places that two pictures share [pixels]; SIFT, Lowe 2004."""
    (points, words), (points_there, words_there) = marks, marks_there
    if words is None or words_there is None or len(words_there) < 2:
        return np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32)
    pairs = cv2.BFMatcher().knnMatch(words, words_there, k=2)
    good = [best for best, second in pairs if best.distance < 0.8 * second.distance]
    here = [points[one.queryIdx].pt for one in good]
    there = [points_there[one.trainIdx].pt for one in good]
    return _as_places(here), _as_places(there)


def _as_places(
    points: list[tuple[float, float]],
) -> Float[np.ndarray, "match 2"]:
    return np.asarray(points, np.float32).reshape(-1, 2) + np.float32(0.5)


def _sampled(
    depths: Float[Tensor, "view height width"], size: tuple[int, int]
) -> Tensor:
    """Depths at another size, none mixed across an edge."""
    return F.interpolate(depths[:, None], size, mode="nearest-exact")[:, 0]
