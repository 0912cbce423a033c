"""Registration: where every image of a scene was taken, relative to view 0.

Two images: one essential matrix. More: the best partner of view 0 sets the scale, points are
triangulated, and each further view is placed on the points it shares with the views already there
(PnP), the best connected first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from edit3r.contract.errors import MatchingError
from edit3r_geometry.cameras import CalibratedImage, Pose, triangulate
from edit3r_geometry.features import MAX_LEARNED, FoundFeatures
from edit3r_geometry.pairs import (
    MIN_LOG_EVIDENCE,
    MIN_PARALLAX,
    PairView,
    agreeing_pairs,
    cells,
)
from edit3r_geometry.relative_pose import MIN_INLIERS, log_chance, support

NEAR = 0.1
"""Points of two pairs within this share of the image's long side tell the scale between them.
No figure kept.
"""
MIN_NEAR = 3
"""How many such points a scale needs."""
ONE_SCALE = 0.1
"""Median deviation of their scales (logarithm) above which they tell none. No figure kept."""
LEAST_USEFUL = 0.15
"""Usefulness over the best neighbour's from which a view measures depth.
See docs/notes/classical.md.
"""
MANY, ALL_OVER = 50, 0.45
"""Matches, and the share of the places where any neighbour has some, from which one measures depth
beside a single other one. No figure kept.
"""
ADVICE = (
    "Give photos of one still scene taken a step apart, with more than half of "
    "the picture in common."
)


@dataclass(frozen=True)
class Registration:
    """Where the views are, in the frame of view 0 and an arbitrary unit of length."""

    poses: tuple[Pose, ...]  # world to camera; identity for a view that was not placed
    registered: Bool[np.ndarray, "view"]
    pairs: dict[tuple[int, int], PairView]  # (a, b) with a < b
    zoom: float = 1.0  # factor by which the focal lengths of all images changed

    @staticmethod
    def on_poses(
        images: Sequence[CalibratedImage],
        features: FoundFeatures,
        poses: dict[int, Pose],
        threshold: float,
        zoom: float = 1.0,
    ) -> "Registration":
        """Views of known `poses` and what they share: matches within `threshold` [pixels], where
        chance gives fewer.

        These are more pairs than show a motion of their own: two views that share a wall alone may
        show a wrong one on right matches. Views that share nothing are not registered. Raises
        MatchingError when view 0 is one of them.
        """
        pairs = {}
        for (a, b), indices in features.indices.items():
            if a in poses and b in poses:
                matches = features.matches(images, a, b)
                pose = poses[b].after(poses[a].inverse())
                _, kept = support(matches, pose, threshold)
                if (
                    log_chance(
                        len(matches), int(kept.sum()), matches.chance * threshold
                    )
                    <= -MIN_LOG_EVIDENCE
                ):
                    pairs[a, b] = PairView.of(matches, indices, kept, pose)
        views = range(len(images))
        placed = np.array([any(view in pair for pair in pairs) for view in views])
        if not placed[0]:
            raise MatchingError(
                "view 0 shares too few features with the other photos on the lines that the known "
                "poses give; look whether poses and photos belong together."
            )
        return Registration(
            tuple(poses.get(view, Pose.identity()) for view in views),
            placed,
            pairs,
            zoom,
        )

    def relative(self, a: int, b: int) -> Pose:
        """From view a's frame to view b's."""
        return self.poses[b].after(self.poses[a].inverse())

    def shared_depths(self, a: int, b: int) -> Float[np.ndarray, "match"]:
        """Camera z in view a of the points matched with view b, one of its neighbours."""
        pair = self.pairs[min(a, b), max(a, b)]
        rays = (
            (pair.matches.rays_a, pair.matches.rays_b)
            if a < b
            else (pair.matches.rays_b, pair.matches.rays_a)
        )
        depth, other = triangulate(*rays, self.relative(a, b))
        return depth[(depth > 0) & (other > 0)]

    def neighbours_of(self, view: int) -> list[int]:
        """Registered views that share points with `view`, many seen from different sides first."""
        near = self._pairs_of(view)
        return sorted(near, key=lambda other: -near[other].usefulness)

    def measuring(self, view: int) -> set[int]:
        """Neighbours that measure the depth of `view`; the others confirm it.

        Where most of what a neighbour shows is something else, it draws the mean cost to wrong
        places. So it is nearly as useful as the best one; beside that one alone, those count too
        that share points all over the view.
        """
        near = self._pairs_of(view)
        best = max((pair.usefulness for pair in near.values()), default=0.0)
        useful = {o for o, p in near.items() if p.usefulness >= LEAST_USEFUL * best}
        if len(useful) > 1:
            return useful
        places = {
            other: cells(pair.matches.rays_a if view < other else pair.matches.rays_b)
            for other, pair in near.items()
        }
        least = ALL_OVER * len(set().union(*places.values()))
        return useful | {
            other
            for other, pair in near.items()
            if len(pair.matches) >= MANY and len(places[other]) >= least
        }

    def _pairs_of(self, view: int) -> dict[int, PairView]:
        """The pairs of `view` by its registered partner."""
        return {
            a + b - view: pair
            for (a, b), pair in self.pairs.items()
            if view in (a, b) and self.registered[a + b - view]
        }


def register(
    images: Sequence[CalibratedImage],
    names: Sequence[str],
    features: FoundFeatures,
    threshold: float,
    seed: int,
    free_focal: bool = False,
) -> Registration:
    """Place the images; `threshold` is what agrees with an epipolar line [pixels at a long side of
    256].

    `names` are for messages. `free_focal`: nobody knows the lens, so that three views and more also
    settle its focal length. Raises MatchingError with the reason when view 0 cannot be placed with
    any other.
    """
    pairs, failures = agreeing_pairs(images, features, threshold, seed)
    first = [(pair, key) for key, pair in pairs.items() if key[0] == 0]
    if not first:
        reasons = "; ".join(
            f"{names[0]} and {names[b]}: {why}"
            for (a, b), why in failures.items()
            if a == 0
        )
        others = [
            names[view] for view in sorted({view for key in pairs for view in key})
        ]
        advice = (
            f"{', '.join(others)} match among themselves: give {others[0]} first, and "
            f"{names[0]} is left out."
            if others
            else ADVICE
        )
        raise MatchingError(
            f"the photos could not be placed relative to each other ({reasons}). {advice}"
        )
    pair, (_, partner) = max(first, key=lambda item: item[0].usefulness)
    growing = _IncrementalRegistration(images, features, pairs, threshold, seed)
    growing.start(partner, pair)
    growing.place_the_rest()
    # Fewer got learned matches first: what these do not join stands at a wrong scale too often.
    while (features.tilted or len(images) > MAX_LEARNED) and growing.join_one():
        growing.place_the_rest()
    return growing.settled(free_focal)


@dataclass
class _IncrementalRegistration:
    """The growing reconstruction: poses, and the 3D points of keypoints (NaN: none yet)."""

    images: Sequence[CalibratedImage]
    features: FoundFeatures
    pairs: dict[tuple[int, int], PairView]
    threshold: float  # [pixels at a long side of 256]
    seed: int
    poses: dict[int, Pose] = field(default_factory=dict)
    points: list[Float[np.ndarray, "keypoint 3"]] = field(default_factory=list)

    def start(self, partner: int, pair: PairView) -> None:
        """Place view 0 and its best partner."""
        self.points = [
            np.full((len(keys), 3), np.nan) for keys in self.features.keypoints
        ]
        self.poses = {0: Pose.identity(), partner: pair.pose}
        self._triangulate_with(partner)

    def place_the_rest(self) -> None:
        """Add the view with most known points until none is left that can be placed."""
        waiting = set(range(len(self.images))) - set(self.poses)
        while waiting:
            known = {view: self._known_points(view) for view in waiting}
            view = max(sorted(waiting), key=lambda v: len(known[v][0]))
            pose = self._place(view, *known[view])
            if pose is not None:
                self.poses[view] = pose
                self._triangulate_with(view)
            waiting.remove(view)

    def join_one(self) -> bool:
        """Add a view that shares no point with two placed ones beside its best neighbour; False
        where none can be added.

        Three views in a row may have no point that all of them see, but points near each other:
        those give the scale of the motion from the second to the third.
        """
        richest = sorted(self.pairs.items(), key=lambda item: -len(item[1].matches))
        for (a, b), pair in richest:
            if (a in self.poses) == (b in self.poses):
                continue
            placed, view = (a, b) if a in self.poses else (b, a)
            scale = self._scale_of(pair, placed, side=int(placed == b))
            if scale is not None:
                motion = pair.pose if placed == a else pair.pose.inverse()
                motion = Pose(motion.rotation, scale * motion.translation)
                self.poses[view] = motion.after(self.poses[placed])
                self._triangulate_with(view)
                return True
        return False

    def _scale_of(self, pair: PairView, placed: int, side: int) -> float | None:
        """By how much the unit of a pair of views is to be multiplied; None: its points tell none.

        `placed` is one of them, the first (`side` 0) or second of the pair.
        """
        depths = triangulate(pair.matches.rays_a, pair.matches.rays_b, pair.pose)
        own = depths[side]
        pixels = self.features.keypoints[placed].points
        known = np.isfinite(self.points[placed][:, 0])
        if not known.any():
            return None
        deep = self.poses[placed].apply(self.points[placed][known])[:, 2]
        places = pixels[pair.indices[:, side]]
        apart = np.linalg.norm(places[:, None] - pixels[known], axis=2)
        nearest = apart.argmin(1)
        near = apart.min(1) <= NEAR * max(self.images[placed].size)
        near &= (own > 0) & (deep[nearest] > 0)
        if near.sum() < MIN_NEAR:
            return None
        scales = np.log(deep[nearest][near] / own[near])
        middle = np.median(scales)
        one_scale = np.median(np.abs(scales - middle)) < ONE_SCALE
        return float(np.exp(middle)) if one_scale else None

    def settled(self, free_focal: bool) -> Registration:
        """What was placed; three and more views adjusted together, and again on all matches that
        agree with that.

        Two are settled by their epipolar geometry already.
        """
        views = range(len(self.images))
        images = self.images
        poses = self.poses
        zoom = 1.0
        placed = np.array([view in poses for view in views])
        found = Registration(
            tuple(poses.get(view, Pose.identity()) for view in views),
            placed,
            self.pairs,
        )
        if len(poses) < 3:
            return found
        from edit3r_geometry.bundle_adjustment import (  # a pair does without
            FIRST_TRACKS,
            MOST_TRACKS,
            adjust,
        )

        limit = self.threshold * max(images[0].size) / 256
        points = [keys.points for keys in self.features.keypoints]
        for most in (FIRST_TRACKS, MOST_TRACKS):
            matches = {pair: view.indices for pair, view in found.pairs.items()}
            poses, change = adjust(
                images, points, matches, poses, 2 * limit, free_focal, most
            )
            images, zoom = [image.zoomed(change) for image in images], zoom * change
            found = Registration.on_poses(images, self.features, poses, limit, zoom)
        return found

    def _known_points(
        self, view: int
    ) -> tuple[Int[np.ndarray, "point"], Float[np.ndarray, "point 3"]]:
        """Keypoints of `view` whose match in a placed view has a 3D point, and those points."""
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

    def _place(
        self,
        view: int,
        indices: Int[np.ndarray, "point"],
        points: Float[np.ndarray, "point 3"],
    ) -> Pose | None:
        """PnP with RANSAC, refined on its inliers; None when too few points agree."""
        if len(indices) < MIN_INLIERS:
            return None
        intrinsics = self.images[view].K
        pixels = self.features.keypoints[view].points[indices]
        threshold = 2 * self.threshold * max(self.images[view].size) / 256
        cv2.setRNGSeed(self.seed)
        found, turn, shift, inliers = cv2.solvePnPRansac(
            points,
            pixels,
            intrinsics,
            None,
            iterationsCount=1000,
            reprojectionError=threshold,
            confidence=0.9999,
            flags=cv2.SOLVEPNP_SQPNP,
        )
        if not found or inliers is None or len(inliers) < MIN_INLIERS:
            return None
        kept = inliers[:, 0]
        turn, shift = cv2.solvePnPRefineLM(
            points[kept], pixels[kept], intrinsics, None, turn, shift
        )
        return Pose(cv2.Rodrigues(turn)[0], shift[:, 0])

    def _triangulate_with(self, view: int) -> None:
        """Give 3D points to matches between `view` and the views already placed."""
        for (a, b), pair in self.pairs.items():
            if view in (a, b) and a in self.poses and b in self.poses:
                pose = self.poses[b].after(self.poses[a].inverse())
                depth_a, depth_b = triangulate(
                    pair.matches.rays_a, pair.matches.rays_b, pose
                )
                good = (depth_a > 0) & (depth_b > 0) & (pair.parallax > MIN_PARALLAX)
                points = (
                    self.poses[a]
                    .inverse()
                    .apply(pair.matches.rays_a[good] * depth_a[good, None])
                )
                for side, indices in zip((a, b), pair.indices[good].T):
                    fresh = ~np.isfinite(self.points[side][indices, 0])
                    self.points[side][indices[fresh]] = points[fresh]
