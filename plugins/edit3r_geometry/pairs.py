"""The motion between two images that their matches show, and whether it is to be believed.

Chance, a poster and repeated patterns all show motions; what other pairs say decides between those
that contradict each other.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from edit3r.contract.reporting import track
from edit3r_geometry.cameras import CalibratedImage, Pose, parallax_degrees, triangulate
from edit3r_geometry.features import FoundFeatures
from edit3r_geometry.relative_pose import (
    MIN_INLIERS,
    Matches,
    TwoViewPose,
    estimate_pose,
    log_false_alarms,
)

MIN_LOG_EVIDENCE = 6.0
"""A pose counts when random matches would agree as well less than once in 10^6 tries.
No figure kept.
"""
MIN_PARALLAX = 0.4
"""Median angle between rays to the same point below which depth cannot be read [degrees].
No figure kept.
"""
ENOUGH_PARALLAX = 5.0
"""Angle beyond which more does not make a better pair [degrees]. No figure kept."""
MOST_PARALLAX = 30.0
"""Angle beyond which surfaces look less and less alike, however many points match [degrees].
No figure kept.
"""
LEARNED_INLIERS = 30
"""Agreeing matches below which a pose that SIFT alone does not show is not believed."""
TILTED_INLIERS = 24
"""The same where images were tilted to find matches: with fewer, one motion in six was wrong."""
DEPTH_STEP = 0.05
"""Median difference of log depth between neighbours in the picture; larger where matches are wrong
together. No figure kept.
"""
SPREAD = 0.2
"""Share of the places with matches that must agree: a wrong motion is often borne by one corner of
the picture. No figure kept.
"""
CORNER = 0.07
"""Share of the area with matches, in one picture times that in the other, below which only a poster
agrees. See docs/notes/classical.md.
"""
MOST_LOOP = 7.0
"""How far the turns from one view to a second, on to a third and back may miss [degrees].
No figure kept.
"""
PLANE = 0.8
"""Share of a pair's matches on one plane above which a small part of the images is a poster.
No figure kept.
"""
MIN_FILLED = 0.045
"""Share of the area that a pair's matches fill, in one picture times that in the other, below which
the motion of tilted images is not believed, unless nearly all matches agree with it.
See docs/notes/classical.md.
"""
FEW_IMAGES = 4
"""Images up to which two robust estimates are made of each motion: of more, the others correct it.
"""
NEARLY_ALL = 0.9
"""Share of the matches that are nearly all. No figure kept."""
_TOO_FEW = "{} of {} matched points agree on a camera motion, too few to be sure"
_ON_A_POSTER = (
    "all {} matched points that agree lie in a small part of both pictures, as on a "
    "poster"
)
_CLOSE_TOGETHER = (
    "the {} of {} matched points that agree lie close together, so their motion is not "
    "sure"
)


@dataclass(frozen=True)
class PairView:
    """Matches of two views that agree on one epipolar geometry, and which features they are."""

    matches: Matches
    indices: Int[np.ndarray, "match 2"]  # keypoints of the first and second view
    pose: Pose  # first view's frame to the second's
    parallax: Float[np.ndarray, "match"]  # [degrees]

    @staticmethod
    def of(
        matches: Matches,
        indices: Int[np.ndarray, "all 2"],
        kept: Bool[np.ndarray, "all"],
        pose: Pose,
    ) -> "PairView":
        """What remains of all matches of two views when those that agree with `pose` are `kept`."""
        agreeing = matches.select(kept)
        return PairView(
            agreeing,
            indices[kept],
            pose,
            parallax_degrees(agreeing.rays_a, agreeing.rays_b, pose),
        )

    @property
    def usefulness(self) -> float:
        """Number of matches, each by how well its depth, and the surface around it, can be read."""
        readable = self.parallax / ENOUGH_PARALLAX
        alike = (MOST_PARALLAX / np.maximum(self.parallax, 1e-9)) ** 2
        return float(np.minimum(np.minimum(readable, alike), 1).sum())


def agreeing_pairs(
    images: Sequence[CalibratedImage],
    features: FoundFeatures,
    threshold: float,
    seed: int,
) -> tuple[dict[tuple[int, int], PairView], dict[tuple[int, int], str]]:
    """The epipolar geometry of every two images that show one; for the others, why not."""
    pairs: dict[tuple[int, int], PairView] = {}
    failures: dict[tuple[int, int], str] = {}
    for (a, b), indices in track(features.indices.items(), "compare cameras"):
        limit = threshold * max(*images[a].size, *images[b].size) / 256
        matches = features.matches(images, a, b)
        learned = features.learned(a, b)
        found = _moved(matches, indices, learned, limit, seed, len(images) > FEW_IMAGES)
        if isinstance(found, str):
            failures[a, b] = found
            continue
        agreeing, sizes = found.matches, (images[a].size, images[b].size)
        doubt = (
            _doubt_of_wide(agreeing, matches, sizes, limit)
            if features.tilted
            else _doubt(agreeing, matches)
        )
        if doubt:
            failures[a, b] = doubt
        else:
            pairs[a, b] = found
    while wrong := _most_contradicted(pairs):
        failures[wrong] = (
            f"{len(pairs.pop(wrong).matches)} matched points agree, but other photos show "
            "another motion"
        )
    return pairs, failures


def _most_contradicted(
    pairs: dict[tuple[int, int], PairView],
) -> tuple[int, int] | None:
    """The pair that most often turns another way than both its views with a third; of several that
    with least matches.

    None where every three views agree.
    """
    against: Counter[tuple[int, int]] = Counter()
    for a, b, c in combinations(sorted({view for pair in pairs for view in pair}), 3):
        three = [(a, b), (b, c), (a, c)]
        if all(pair in pairs for pair in three):
            first, second, direct = (pairs[pair].pose.rotation for pair in three)
            if (
                np.degrees(np.linalg.norm(cv2.Rodrigues(second @ first @ direct.T)[0]))
                > MOST_LOOP
            ):
                against.update(three)
    return max(
        against,
        key=lambda pair: (against[pair], -len(pairs[pair].matches)),
        default=None,
    )


def _doubt(agreeing: Matches, matches: Matches) -> str:
    """Why a motion is not believed; empty where it is."""
    return _ON_A_POSTER.format(len(agreeing)) if _in_a_corner(agreeing, matches) else ""


def _doubt_of_wide(
    agreeing: Matches,
    matches: Matches,
    sizes: Sequence[tuple[int, int]],
    threshold: float,
) -> str:
    """As `_doubt`, for photos of `sizes` (height, width) from wide apart; `threshold` in pixels.

    They have a small part in common, so a poster is told by its being flat.
    """
    if len(agreeing) < TILTED_INLIERS:
        return _TOO_FEW.format(len(agreeing), len(matches))
    if _in_a_corner(agreeing, matches) and on_a_plane(agreeing, 2 * threshold):
        return _ON_A_POSTER.format(len(agreeing))
    if (
        len(agreeing) < NEARLY_ALL * len(matches)
        and _filled(agreeing, sizes) < MIN_FILLED
    ):
        return _CLOSE_TOGETHER.format(len(agreeing), len(matches))
    return ""


def _moved(
    matches: Matches,
    indices: Int[np.ndarray, "match 2"],
    learned: Bool[np.ndarray, "match"],
    threshold: float,
    seed: int,
    once: bool,
) -> PairView | str:
    """The motion that the matches of two images show, and those that agree, or why none does."""
    found = estimate_pose(matches, threshold, seed, once)
    evident = _evident(found, matches, learned, threshold)
    # where SIFT's matches are nearly all wrong, they hide what the others say
    if not evident and learned.any():
        alone = matches.select(learned)
        second = estimate_pose(alone, threshold, seed)
        if _evident(second, alone, learned[learned], threshold):
            evident, found, matches, indices = True, second, alone, indices[learned]
    if not evident or found is None:
        agreeing = 0 if found is None else int(found.inliers.sum())
        return _TOO_FEW.format(agreeing, len(matches))
    pair = PairView.of(matches, indices, found.inliers, found.pose)
    parallax = np.median(pair.parallax)
    if parallax < MIN_PARALLAX:
        return (
            f"taken from nearly the same place ({parallax:.2f} degrees of parallax), so "
            "depth cannot be read"
        )
    return pair


def _in_a_corner(agreeing: Matches, matches: Matches) -> bool:
    """Whether what agrees fills a small part of the matches of both images: one thing only."""
    both = (agreeing, matches)
    inside = [
        [
            cv2.contourArea(cv2.convexHull(np.float32(rays[:, :2])))
            for rays in (m.rays_a, m.rays_b)
        ]
        for m in both
    ]
    places = [[len(cells(rays)) for rays in (m.rays_a, m.rays_b)] for m in both]
    in_corner = np.divide(inside[0], inside[1])
    return bool(
        np.prod(in_corner) < CORNER and min(np.divide(places[0], places[1])) < 0.5
    )


def _filled(agreeing: Matches, sizes: Sequence[tuple[int, int]]) -> float:
    """Share of the area that the matches fill, in one picture times that in the other.

    Each area is that of the ellipse two standard deviations wide, which stray matches move little.
    """
    shares = []
    for rays, size in zip((agreeing.rays_a, agreeing.rays_b), sizes):
        spread = np.linalg.det(np.cov(agreeing.focal * rays[:, :2].T))
        shares.append(4 * np.pi * np.sqrt(max(spread, 0.0)) / np.prod(size))
    return float(np.prod(shares))


def on_a_plane(agreeing: Matches, threshold: float, share: float = PLANE) -> bool:
    """Whether one homography explains nearly all that agrees."""
    points_a = agreeing.focal * agreeing.rays_a[:, :2]
    points_b = agreeing.focal * agreeing.rays_b[:, :2]
    cv2.setRNGSeed(0)
    _, kept = cv2.findHomography(points_a, points_b, cv2.RANSAC, threshold)
    return kept is None or kept.mean() > share


def cells(rays: Float[np.ndarray, "match 3"]) -> set[tuple[float, float]]:
    """The cells of the picture where there are any."""
    return set(map(tuple, np.floor(6 * rays[:, :2]).tolist()))


def _evident(
    found: TwoViewPose | None,
    matches: Matches,
    learned: Bool[np.ndarray, "match"],
    threshold: float,
) -> bool:
    """Whether matches show a pose beyond doubt: SIFT's against chance, or many of both kinds."""
    if found is None:
        return False
    exact = int((found.inliers & ~learned).sum())
    alone = log_false_alarms(int((~learned).sum()), exact, matches.chance * threshold)
    if exact >= MIN_INLIERS and alone <= -MIN_LOG_EVIDENCE:
        return True
    many = bool(learned.any()) and found.inliers.sum() >= LEARNED_INLIERS
    return (
        many
        and found.log_false_alarms <= -MIN_LOG_EVIDENCE
        and _holds_together(found, matches)
    )


def _holds_together(found: TwoViewPose, matches: Matches) -> bool:
    """Whether the points that agree form surfaces, and lie all over the places where there are
    matches.

    Wrong learned matches are wrong together, so counting them against chance proves little. But the
    epipolar lines say nothing about where along them a match lies, and points of wrong matches have
    depths that jump.
    """
    kept = matches.select(found.inliers)
    depth, _ = triangulate(kept.rays_a, kept.rays_b, found.pose)
    readable = parallax_degrees(kept.rays_a, kept.rays_b, found.pose) > 1.0
    places, log_depth = kept.rays_a[readable], np.log(depth[readable])
    if len(places) < LEARNED_INLIERS:
        return False
    from scipy.spatial import cKDTree  # learned features only

    # itself and four neighbours
    _, near = cKDTree(places[:, :2]).query(places[:, :2], 5)
    step = np.median(np.abs(log_depth[near[:, 1:]] - log_depth[:, None]))
    return bool(
        step <= DEPTH_STEP
        and len(cells(kept.rays_a)) >= SPREAD * len(cells(matches.rays_a))
    )
