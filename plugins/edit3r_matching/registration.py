"""Places every photo of a scene relative to view 0.

Two photos: one essential matrix. More: the best partner of view 0 sets the scale, points are triangulated, and each
further view is placed on the points it shares with the views already there (PnP), the best connected first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import cv2
import numpy as np

from edit3r.errors import MatchingError
from edit3r_matching.camera import Picture, Pose, rays_through
from edit3r_matching.features import Keypoints, detect, match
from edit3r_matching.relative_pose import MIN_INLIERS, Matches, TwoViewPose, estimate_pose
from edit3r_matching.triangulation import parallax_degrees, triangulate

__all__ = ["FoundFeatures", "PairView", "Registration", "RegistrationOptions", "find_features", "register"]

MIN_LOG_EVIDENCE = 6.0
"""A pose counts when random matches would agree as well less than once in 10^6 tries."""
MIN_PARALLAX = 0.4
"""Median angle between rays to the same point below which depth cannot be read [degrees]."""

_ENOUGH_PARALLAX = 5.0  # degrees beyond which more does not make a better first pair


@dataclass(frozen=True)
class PairView:
    """Matches of two views that agree on one epipolar geometry, with which feature of each view they are."""

    matches: Matches
    indices: np.ndarray  # [N, 2] keypoints of the first and second view
    pose: Pose  # first view's frame to the second's, translation of length 1
    parallax: np.ndarray  # [N] degrees


@dataclass(frozen=True)
class Registration:
    """Where the views are, in the frame of view 0 and an arbitrary unit of length."""

    poses: tuple[Pose, ...]  # world to camera; identity for a view that was not placed
    registered: np.ndarray  # [V] bool
    pairs: dict[tuple[int, int], PairView]  # (a, b) with a < b

    def relative(self, a: int, b: int) -> Pose:
        """From view a's frame to view b's."""
        return self.poses[b].after(self.poses[a].inverse())

    def shared_depths(self, a: int, b: int) -> np.ndarray:
        """Camera z in view a of the points matched with view b; [] when the two share none."""
        pair = self.pairs.get((min(a, b), max(a, b)))
        if pair is None:
            return np.zeros(0)
        rays = (pair.matches.rays_a, pair.matches.rays_b) if a < b else (pair.matches.rays_b, pair.matches.rays_a)
        depth, other = triangulate(*rays, self.relative(a, b))
        return depth[(depth > 0) & (other > 0)]

    def partners(self, view: int) -> list[int]:
        """Registered views that share points with `view`, most useful first: many points, seen from different sides."""
        found = [(a + b - view, pair) for (a, b), pair in self.pairs.items() if view in (a, b)]
        usable = [(other, pair) for other, pair in found if self.registered[other]]
        return [other for other, _ in sorted(usable, key=lambda item: -_usefulness(item[1]))]


@dataclass(frozen=True)
class RegistrationOptions:
    """See the matcher's settings of the same names; `threshold` in pixels at a long side of 256."""

    keypoints: int
    detection_size: int
    ratio: float
    threshold: float
    seed: int


@dataclass(frozen=True)
class FoundFeatures:
    """Features of every photo, and which of them look alike."""

    keypoints: tuple[Keypoints, ...]
    indices: dict[tuple[int, int], np.ndarray]  # (a, b) with a < b: [N, 2] keypoints of the first and second photo

    def matches(self, photos: Sequence[Picture], a: int, b: int) -> Matches:
        """What photos a and b have in common, as rays of their cameras."""
        indices = self.indices[a, b]
        points = (self.keypoints[view].points[indices[:, side]] for side, view in enumerate((a, b)))
        return _as_matches(photos[a], photos[b], *points)


def find_features(photos: Sequence[Picture], options: RegistrationOptions) -> FoundFeatures:
    """Detect features and match every two photos; needs no intrinsics."""
    keypoints = tuple(detect(photo.image, options.keypoints, options.detection_size) for photo in photos)
    every = combinations(range(len(photos)), 2)
    return FoundFeatures(keypoints, {(a, b): match(keypoints[a], keypoints[b], options.ratio) for a, b in every})


def register(
    photos: Sequence[Picture], names: Sequence[str], features: FoundFeatures, options: RegistrationOptions
) -> Registration:
    """Place the photos. Raises MatchingError with the reason when view 0 cannot be placed with any other."""
    pairs: dict[tuple[int, int], PairView] = {}
    failures: dict[tuple[int, int], str] = {}
    for (a, b), indices in features.indices.items():
        found = _pair(features.matches(photos, a, b), indices, max(*photos[a].size, *photos[b].size), options)
        if isinstance(found, PairView):
            pairs[a, b] = found
        else:
            failures[a, b] = found
    first = [(pair, key) for key, pair in pairs.items() if key[0] == 0]
    if not first:
        reasons = "; ".join(f"{names[0]} and {names[b]}: {why}" for (a, b), why in failures.items() if a == 0)
        raise MatchingError(f"the photos could not be placed relative to each other ({reasons}). {_ADVICE}")
    pair, (_, partner) = max(first, key=lambda item: _usefulness(item[0]))
    placing = _Placing(photos, features.keypoints, pairs, options)
    placing.start(partner, pair)
    placing.place_the_rest()
    return placing.result()


_ADVICE = "Give photos of one still scene taken a step apart, with more than half of the picture in common."


def _pair(matches: Matches, indices: np.ndarray, longest: int, options: RegistrationOptions) -> PairView | str:
    """The pair's epipolar geometry, or the reason why there is none; `longest` is the photos' longest side [pixels]."""
    threshold = options.threshold * longest / 256
    found = estimate_pose(matches, threshold, options.seed)
    if found is None or found.log_false_alarms > -MIN_LOG_EVIDENCE or found.inliers.sum() < MIN_INLIERS:
        agreeing = 0 if found is None else int(found.inliers.sum())
        return f"{agreeing} of {len(matches)} matched points agree on a camera motion, too few to be sure"
    return _with_parallax(matches, indices, found)


def _with_parallax(matches: Matches, indices: np.ndarray, found: TwoViewPose) -> PairView | str:
    kept = Matches(matches.rays_a[found.inliers], matches.rays_b[found.inliers], matches.focal, matches.chance)
    parallax = parallax_degrees(kept.rays_a, kept.rays_b, found.pose)
    if np.median(parallax) < MIN_PARALLAX:
        return (
            f"taken from nearly the same place ({np.median(parallax):.2f} degrees of parallax), so depth cannot be read"
        )
    return PairView(kept, indices[found.inliers], found.pose, parallax)


def _as_matches(a: Picture, b: Picture, points_a: np.ndarray, points_b: np.ndarray) -> Matches:
    focals = [picture.intrinsics[axis, axis] for picture in (a, b) for axis in (0, 1)]
    height, width = b.size
    # A band of two pixels along the longest possible line, over the picture's area.
    chance = 2 * np.hypot(height, width) / (height * width)
    return Matches(
        rays_through(points_a, a.intrinsics), rays_through(points_b, b.intrinsics), float(np.mean(focals)), chance
    )


def _usefulness(pair: PairView) -> float:
    """Number of matches, each counted by how well its depth can be read."""
    return float(np.minimum(pair.parallax / _ENOUGH_PARALLAX, 1).sum())


@dataclass
class _Placing:
    """The growing reconstruction: poses, and the 3D point of each keypoint that has one (NaN: none yet)."""

    photos: Sequence[Picture]
    keypoints: Sequence[Keypoints]
    pairs: dict[tuple[int, int], PairView]
    options: RegistrationOptions
    poses: dict[int, Pose] = field(default_factory=dict)
    points: list[np.ndarray] = field(default_factory=list)

    def start(self, partner: int, pair: PairView) -> None:
        self.points = [np.full((len(keys), 3), np.nan) for keys in self.keypoints]
        self.poses = {0: Pose.identity(), partner: pair.pose}
        self._triangulate_with(partner)

    def place_the_rest(self) -> None:
        """Add the view with most known points until none is left that can be placed."""
        waiting = set(range(len(self.photos))) - set(self.poses)
        while waiting:
            known = {view: self._known_points(view) for view in waiting}
            view = max(sorted(waiting), key=lambda v: len(known[v][0]))
            pose = self._place(view, *known[view])
            waiting.remove(view)
            if pose is not None:
                self.poses[view] = pose
                self._triangulate_with(view)

    def result(self) -> Registration:
        views = range(len(self.photos))
        poses = tuple(self.poses.get(view, Pose.identity()) for view in views)
        return Registration(poses, np.array([view in self.poses for view in views]), self.pairs)

    def _known_points(self, view: int) -> tuple[np.ndarray, np.ndarray]:
        """Keypoint indices of `view` whose match in a placed view has a 3D point, and those points."""
        own, points = [], []
        for (a, b), pair in self.pairs.items():
            if view in (a, b) and (other := a + b - view) in self.poses:
                mine, theirs = (0, 1) if view == a else (1, 0)
                candidates = self.points[other][pair.indices[:, theirs]]
                known = np.isfinite(candidates[:, 0])
                own.append(pair.indices[known, mine])
                points.append(candidates[known])
        if not own:
            return np.zeros(0, int), np.zeros((0, 3))
        return np.concatenate(own), np.concatenate(points)

    def _place(self, view: int, indices: np.ndarray, points: np.ndarray) -> Pose | None:
        """PnP with RANSAC, refined on its inliers; None when too few points agree."""
        if len(indices) < MIN_INLIERS:
            return None
        photo = self.photos[view]
        image = self.keypoints[view].points[indices]
        threshold = 2 * self.options.threshold * max(photo.size) / 256
        cv2.setRNGSeed(self.options.seed)
        found, turn, shift, inliers = cv2.solvePnPRansac(
            points,
            image,
            photo.intrinsics,
            None,
            iterationsCount=1000,
            reprojectionError=threshold,
            confidence=0.9999,
            flags=cv2.SOLVEPNP_SQPNP,
        )
        if not found or inliers is None or len(inliers) < MIN_INLIERS:
            return None
        kept = inliers[:, 0]
        turn, shift = cv2.solvePnPRefineLM(points[kept], image[kept], photo.intrinsics, None, turn, shift)
        return Pose(cv2.Rodrigues(turn)[0], shift[:, 0])

    def _triangulate_with(self, view: int) -> None:
        """Give 3D points to matches between `view` and the views already placed."""
        for (a, b), pair in self.pairs.items():
            if view in (a, b) and a in self.poses and b in self.poses:
                pose = self.poses[b].after(self.poses[a].inverse())
                depth_a, depth_b = triangulate(pair.matches.rays_a, pair.matches.rays_b, pose)
                good = (depth_a > 0) & (depth_b > 0) & (pair.parallax > MIN_PARALLAX)
                points = self.poses[a].inverse().apply(pair.matches.rays_a[good] * depth_a[good, None])
                for side, indices in zip((a, b), pair.indices[good].T):
                    fresh = ~np.isfinite(self.points[side][indices, 0])
                    self.points[side][indices[fresh]] = points[fresh]
