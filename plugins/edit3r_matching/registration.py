"""Registration: where every image of a scene was taken, relative to view 0.

Two images: one essential matrix. More: the best partner of view 0 sets the scale, points are
triangulated, and each further view is placed on the points it shares with the views already there
(PnP), the best connected first.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from pydantic import Field

from edit3r import config
from edit3r.errors import MatchingError
from edit3r.plugins import weights
from edit3r_matching.cameras import (
    CalibratedImage,
    Pose,
    parallax_degrees,
    rays_through,
    triangulate,
)
from edit3r_matching.features import (
    Keypoints,
    detect,
    detect_tilted,
    match,
    match_tilted,
)
from edit3r_matching.relative_pose import (
    MIN_INLIERS,
    Matches,
    TwoViewPose,
    estimate_pose,
    log_chance,
    log_false_alarms,
    support,
)

__all__ = [
    "FeatureSettings",
    "FoundFeatures",
    "PairView",
    "Registration",
    "agreeing_pairs",
    "find_features",
    "register",
    "with_tilted",
]

LEARNED = {
    "learned": ("aliked-lightglue", "ALIKED + LightGlue"),
    "efficientloftr": ("efficientloftr", "EfficientLoFTR"),
    "superpoint": ("superpoint-lightglue", "SuperPoint + LightGlue"),
}
"""Learned sources of matches: the name of their weights, see `edit3r.plugins.weights`, and what to
call them.
"""
MIN_LOG_EVIDENCE = 6.0
"""A pose counts when random matches would agree as well less than once in 10^6 tries."""
MIN_PARALLAX = 0.4
"""Median angle between rays to the same point below which depth cannot be read [degrees]."""
ENOUGH_PARALLAX = 5.0
"""Angle beyond which more does not make a better pair [degrees]."""
MOST_PARALLAX = 30.0
"""Angle beyond which surfaces look less and less alike, however many points match [degrees]."""
LEARNED_INLIERS = 30
"""Agreeing matches below which a pose that SIFT alone does not show is not believed."""
TILTED_INLIERS = 24
"""The same where images were tilted to find matches: with fewer, one motion in six was wrong."""
LEARNED_NOISE = 4.0
"""How many times less exact than SIFT's the learned points are taken to be where a pose is refined.
"""
DEPTH_STEP = 0.05
"""Median difference of log depth between neighbours in the picture; larger where matches are wrong
together.
"""
SPREAD = 0.2
"""Share of the places with matches that must agree: a wrong motion is often borne by one corner of
the picture.
"""
CORNER = 0.07
"""Share of the area with matches, in one picture times that in the other, below which only a poster
agrees.
"""
MOST_LOOP = 7.0
"""How far the turns from one view to a second, on to a third and back may miss [degrees]."""
NEAR = 0.1
"""Points of two pairs within this share of the image's long side tell the scale between them."""
MIN_NEAR = 3
"""How many such points a scale needs."""
ONE_SCALE = 0.1
"""Median deviation of their scales (logarithm) above which they tell none."""
MAX_TILTED_PAIRS = 30
"""Pairs of images that are tilted and matched again; each takes a third of a second."""
PLANE = 0.8
"""Share of a pair's matches on one plane above which a small part of the images is a poster."""
MIN_FILLED = 0.045
"""Share of the area that a pair's matches fill, in one picture times that in the other, below which
the motion of tilted images is not believed, unless nearly all matches agree with it.
"""
NEARLY_ALL = 0.9
"""Share of the matches that are nearly all."""
ENOUGH_MATCHES = 250
"""Matches of SIFT that place two views without help."""
_TOO_FEW = "{} of {} matched points agree on a camera motion, too few to be sure"
_ON_A_POSTER = (
    "all {} matched points that agree lie in a small part of both pictures, as on a "
    "poster"
)
_CLOSE_TOGETHER = (
    "the {} of {} matched points that agree lie close together, so their motion is not "
    "sure"
)
ADVICE = (
    "Give photos of one still scene taken a step apart, with more than half of "
    "the picture in common."
)


@dataclass(frozen=True)
class PairView:
    """Matches of two views that agree on one epipolar geometry, with which feature of each view
    they are.
    """

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
        """What remains of all matches of two views when only those that agree with `pose` are
        `kept`.
        """
        agreeing = matches.select(kept)
        return PairView(
            agreeing,
            indices[kept],
            pose,
            parallax_degrees(agreeing.rays_a, agreeing.rays_b, pose),
        )

    @property
    def usefulness(self) -> float:
        """Number of matches, each counted by how well its depth can be read, and the surface around
        it compared.
        """
        readable, alike = (
            self.parallax / ENOUGH_PARALLAX,
            (MOST_PARALLAX / np.maximum(self.parallax, 1e-9)) ** 2,
        )
        return float(np.minimum(np.minimum(readable, alike), 1).sum())


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
        features: "FoundFeatures",
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
                matches, pose = (
                    features.matches(images, a, b),
                    poses[b].after(poses[a].inverse()),
                )
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
                "view 0 shares too few features with the other photos on the lines that the "
                "known poses give; "
                "look whether poses and photos belong together."
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
        """Registered views that share points with `view`, most useful first: many points, seen from
        different sides.
        """
        found = [
            (a + b - view, pair)
            for (a, b), pair in self.pairs.items()
            if view in (a, b)
        ]
        usable = [(other, pair) for other, pair in found if self.registered[other]]
        return [
            other for other, _ in sorted(usable, key=lambda item: -item[1].usefulness)
        ]


class FeatureSettings(config.Settings):
    """How features are found and matched."""

    keypoints: int = Field(4000, ge=200, le=20000, description="most features a photo")
    detection_size: int = Field(
        640,
        ge=128,
        le=4096,
        description="long side at which features are looked for [pixels]; larger finds more",
    )
    ratio: float = Field(
        0.85,
        gt=0,
        le=1,
        description="a match must be this much nearer than its second choice (Lowe's test)",
    )
    matches: Literal["auto", "sift", "learned", "efficientloftr", "superpoint"] = Field(
        "auto",
        description="'learned': SIFT's together with ALIKED + LightGlue's, whose weights `edit3r "
        "weights get "
        "aliked-lightglue` fetches; 'auto': so for two photos with few matches, where those "
        "weights are at hand; "
        "'efficientloftr', 'superpoint': with those of transformers, weights 'efficientloftr', "
        "'superpoint-lightglue'",
    )
    learned_keypoints: int = Field(
        1024, ge=128, le=4096, description="most learned features a photo"
    )


@dataclass(frozen=True)
class FoundFeatures:
    """Features of every image, and which of them look alike."""

    keypoints: tuple[Keypoints, ...]
    indices: dict[
        tuple[int, int], Int[np.ndarray, "match 2"]
    ]  # (a, b) with a < b: keypoints of images a and b
    sift: tuple[
        int, ...
    ] = ()  # per image: how many of its first keypoints are SIFT's, the others are learned; (): all
    helper: str = ""  # what to call the source of the learned ones
    tilted: bool = False  # some are of tilted images: for photos taken from wide apart

    def learned(self, a: int, b: int) -> Bool[np.ndarray, "match"]:
        """Which matches of images a and b are learned ones."""
        return self.indices[a, b][:, 0] >= (
            self.sift[a] if self.sift else len(self.keypoints[a])
        )

    def matches(self, images: Sequence[CalibratedImage], a: int, b: int) -> Matches:
        """What images a and b have in common, as rays of their cameras."""
        pair, indices = (images[a], images[b]), self.indices[a, b]
        points = (
            self.keypoints[view].points[indices[:, side]]
            for side, view in enumerate((a, b))
        )
        rays = (rays_through(own, image.intrinsics) for own, image in zip(points, pair))
        focals = [image.intrinsics[axis, axis] for image in pair for axis in (0, 1)]
        height, width = images[b].size
        # A band of two pixels along the longest possible line, over the image's area.
        chance = 2 * np.hypot(height, width) / (height * width)
        learned = self.learned(a, b)
        noise = np.where(learned, LEARNED_NOISE, 1.0) if learned.any() else None
        return Matches(*rays, float(np.mean(focals)), chance, noise)


def find_features(
    images: Sequence[CalibratedImage], settings: FeatureSettings
) -> FoundFeatures:
    """Detect features and match every two images; needs no intrinsics.

    Raises MissingDependencyError where learned matches are asked for and their weights are not at
    hand.
    """
    keypoints = tuple(
        detect(image.pixels, settings.keypoints, settings.detection_size)
        for image in images
    )
    every = combinations(range(len(images)), 2)
    found = FoundFeatures(
        keypoints,
        {(a, b): match(keypoints[a], keypoints[b], settings.ratio) for a, b in every},
    )
    asked = settings.matches in LEARNED
    few = [
        pair
        for pair, indices in found.indices.items()
        if asked or len(indices) < ENOUGH_MATCHES
    ]
    if settings.matches == "sift" or not few:
        return found
    declared = weights.named(LEARNED[settings.matches if asked else "learned"][0])
    folder = weights.find(declared) if asked else weights.at_hand(declared)
    return (
        found if folder is None else _with_learned(found, few, images, folder, settings)
    )


def with_tilted(
    found: FoundFeatures,
    images: Sequence[CalibratedImage],
    lost: Collection[int],
    settings: FeatureSettings,
) -> FoundFeatures:
    """Match images again as they would look from aside: the `lost` ones, and other pairs with few
    matches.
    """
    few = [
        (a not in lost and b not in lost, -len(indices), (a, b))
        for (a, b), indices in found.indices.items()
        if a in lost or b in lost or len(indices) < ENOUGH_MATCHES
    ]
    pairs = [pair for _, _, pair in sorted(few)[:MAX_TILTED_PAIRS]]
    limit = settings.keypoints // 2
    groups = {
        view: [
            found.keypoints[view],
            *detect_tilted(images[view].pixels, limit, settings.detection_size),
        ]
        for view in sorted({view for pair in pairs for view in pair})
    }
    longest = max(max(image.size) for image in images)
    matches = {(a, b): match_tilted(groups[a], groups[b], longest) for a, b in pairs}
    keypoints = list(found.keypoints)
    for view, tilted in groups.items():
        for more in tilted[1:]:
            keypoints[view] = keypoints[view].followed_by(more)
    return FoundFeatures(tuple(keypoints), found.indices | matches, tilted=True)


def _with_learned(
    found: FoundFeatures,
    pairs: Sequence[tuple[int, int]],
    images: Sequence[CalibratedImage],
    folder: Path,
    settings: FeatureSettings,
) -> FoundFeatures:
    """Add learned matches of `pairs` to those `found`; `folder` holds the weights."""
    from edit3r_matching import (
        learned,  # torch's networks, kornia and transformers load only where they are used
    )

    name, called = LEARNED.get(settings.matches, LEARNED["learned"])
    networks = learned.load(name, folder, settings.learned_keypoints)
    views = sorted({view for pair in pairs for view in pair})
    more, own = networks.between(
        {view: images[view].pixels for view in views}, pairs, settings.detection_size
    )
    sift = tuple(map(len, found.keypoints))
    indices = dict(found.indices)
    for a, b in pairs:
        indices[a, b] = np.concatenate(
            (indices[a, b], own[a, b] + np.array([sift[a], sift[b]]))
        )
    keypoints = tuple(
        k.followed_by(more[view]) if view in more else k
        for view, k in enumerate(found.keypoints)
    )
    return FoundFeatures(keypoints, indices, sift, called)


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
        raise MatchingError(
            f"the photos could not be placed relative to each other ({reasons}). {ADVICE}"
        )
    pair, (_, partner) = max(first, key=lambda item: item[0].usefulness)
    growing = _IncrementalRegistration(images, features, pairs, threshold, seed)
    growing.start(partner, pair)
    growing.place_the_rest()
    while features.tilted and growing.join_one():
        growing.place_the_rest()
    return growing.settled(free_focal)


def agreeing_pairs(
    images: Sequence[CalibratedImage],
    features: FoundFeatures,
    threshold: float,
    seed: int,
) -> tuple[dict[tuple[int, int], PairView], dict[tuple[int, int], str]]:
    """The epipolar geometry of every two images that show one; for the others, why not."""
    pairs: dict[tuple[int, int], PairView] = {}
    failures: dict[tuple[int, int], str] = {}
    for (a, b), indices in features.indices.items():
        limit = threshold * max(*images[a].size, *images[b].size) / 256
        matches = features.matches(images, a, b)
        judged = _wide_pair if features.tilted else _pair
        found = judged(matches, indices, features.learned(a, b), limit, seed)
        if features.tilted and isinstance(found, PairView):
            agreeing, sizes = len(found.matches), (images[a].size, images[b].size)
            doubtful = agreeing < NEARLY_ALL * len(matches)
            if doubtful and _filled(found.matches, sizes) < MIN_FILLED:
                found = _CLOSE_TOGETHER.format(agreeing, len(matches))
        if isinstance(found, PairView):
            pairs[a, b] = found
        else:
            failures[a, b] = found
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


def _pair(
    matches: Matches,
    indices: Int[np.ndarray, "match 2"],
    learned: Bool[np.ndarray, "match"],
    threshold: float,
    seed: int,
) -> PairView | str:
    """The pair's epipolar geometry, or the reason why there is none; `threshold` in pixels."""
    pair = _moved(matches, indices, learned, threshold, seed)
    if isinstance(pair, PairView) and _in_a_corner(pair.matches, matches):
        return _ON_A_POSTER.format(len(pair.matches))
    return pair


def _wide_pair(
    matches: Matches,
    indices: Int[np.ndarray, "match 2"],
    learned: Bool[np.ndarray, "match"],
    threshold: float,
    seed: int,
) -> PairView | str:
    """As `_pair`, for photos from wide apart.

    They have a small part in common, so a poster is told by its being flat.
    """
    pair = _moved(matches, indices, learned, threshold, seed)
    if isinstance(pair, str):
        return pair
    agreeing = len(pair.matches)
    if agreeing < TILTED_INLIERS:
        return _TOO_FEW.format(agreeing, len(matches))
    if _in_a_corner(pair.matches, matches) and _on_a_plane(pair.matches, threshold):
        return _ON_A_POSTER.format(agreeing)
    return pair


def _moved(
    matches: Matches,
    indices: Int[np.ndarray, "match 2"],
    learned: Bool[np.ndarray, "match"],
    threshold: float,
    seed: int,
) -> PairView | str:
    """The motion that the matches of two images show, with those that agree, or why there is
    none.
    """
    found = estimate_pose(matches, threshold, seed)
    evident = _evident(found, matches, learned, threshold)
    if (
        not evident and learned.any()
    ):  # where SIFT's matches are nearly all wrong, they hide what the others say
        alone = matches.select(learned)
        second = estimate_pose(alone, threshold, seed)
        if _evident(second, alone, learned[learned], threshold):
            evident, found, matches, indices = True, second, alone, indices[learned]
    if not evident:
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
    """Whether, in both images, what agrees fills a small part of where there are matches: they show
    one thing only.
    """
    both = (agreeing, matches)
    inside = [
        [
            cv2.contourArea(cv2.convexHull(np.float32(rays[:, :2])))
            for rays in (m.rays_a, m.rays_b)
        ]
        for m in both
    ]
    places = [[_places(rays) for rays in (m.rays_a, m.rays_b)] for m in both]
    return bool(np.prod(np.divide(*inside)) < CORNER and min(np.divide(*places)) < 0.5)


def _filled(agreeing: Matches, sizes: Sequence[tuple[int, int]]) -> float:
    """Share of the area that the matches fill, in one picture times that in the other.

    Each area is that of the ellipse two standard deviations wide, which stray matches move little.
    """
    shares = []
    for rays, size in zip((agreeing.rays_a, agreeing.rays_b), sizes):
        spread = np.linalg.det(np.cov(agreeing.focal * rays[:, :2].T))
        shares.append(4 * np.pi * np.sqrt(max(spread, 0.0)) / np.prod(size))
    return float(np.prod(shares))


def _on_a_plane(agreeing: Matches, threshold: float) -> bool:
    """Whether one homography explains nearly all that agrees."""
    points = [
        agreeing.focal * rays[:, :2] for rays in (agreeing.rays_a, agreeing.rays_b)
    ]
    cv2.setRNGSeed(0)
    _, kept = cv2.findHomography(*points, cv2.RANSAC, 2 * threshold)
    return kept is None or kept.mean() > PLANE


def _places(rays: Float[np.ndarray, "match 3"]) -> int:
    """In how many cells of the picture there are any."""
    return len(np.unique(np.floor(6 * rays[:, :2]), axis=0))


def _evident(
    found: TwoViewPose | None,
    matches: Matches,
    learned: Bool[np.ndarray, "match"],
    threshold: float,
) -> bool:
    """Whether the matches show a pose beyond doubt: SIFT's alone against chance, or many of both
    kinds.
    """
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

    _, near = cKDTree(places[:, :2]).query(
        places[:, :2], 5
    )  # itself and four neighbours
    step = np.median(np.abs(log_depth[near[:, 1:]] - log_depth[:, None]))
    return bool(
        step <= DEPTH_STEP and _places(kept.rays_a) >= SPREAD * _places(matches.rays_a)
    )


@dataclass
class _IncrementalRegistration:
    """The growing reconstruction: poses, and the 3D point of each keypoint that has one (NaN: none
    yet).
    """

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
        views, images, poses, zoom = (
            range(len(self.images)),
            self.images,
            self.poses,
            1.0,
        )
        placed = np.array([view in poses for view in views])
        found = Registration(
            tuple(poses.get(view, Pose.identity()) for view in views),
            placed,
            self.pairs,
        )
        if len(poses) < 3:
            return found
        from edit3r_matching.bundle_adjustment import adjust

        limit = self.threshold * max(images[0].size) / 256
        points = [keys.points for keys in self.features.keypoints]
        for _ in range(2):
            matches = {pair: view.indices for pair, view in found.pairs.items()}
            poses, change = adjust(
                images, points, matches, poses, 2 * limit, free_focal
            )
            images, zoom = [image.zoomed(change) for image in images], zoom * change
            found = Registration.on_poses(images, self.features, poses, limit, zoom)
        return found

    def _known_points(
        self, view: int
    ) -> tuple[Int[np.ndarray, "point"], Float[np.ndarray, "point 3"]]:
        """Keypoint indices of `view` whose match in a placed view has a 3D point, and those
        points.
        """
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
        intrinsics, pixels = (
            self.images[view].intrinsics,
            self.features.keypoints[view].points[indices],
        )
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
