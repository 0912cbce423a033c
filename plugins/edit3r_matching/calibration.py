"""Reads the field of view from the images themselves where nobody knows it.

A wrong focal length bends the epipolar geometry, and fewer matches agree with any camera motion. So
the focal length is looked for with which most matches agree: a scan over plausible fields of view,
then between the best neighbours. Photos without known intrinsics are taken to share one field of
view across their longer side. A weak preference for what was assumed decides where the matches do
not care, as when a camera only moved sideways.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from edit3r_matching.cameras import CalibratedImage, Pose
from edit3r_matching.relative_pose import Matches, refine, rough_pose, sharp_support

__all__ = [
    "PREFERENCE",
    "WIDE_PREFERENCE",
    "PointPairs",
    "calibrate",
    "contradiction",
]

FIELDS_OF_VIEW = (28.0, 36.0, 46.0, 57.0, 68.0, 80.0, 94.0)
"""Across the longer side [degrees], from a short telephoto lens to an action camera."""

PointPairs = Mapping[tuple[int, int], Matches]
"""Matches of two images, their rays made with the intrinsics that the images have now."""

_MOST_PAIRS = 2
_FEWEST_MATCHES = 40
PREFERENCE = 0.01
"""Share of the matches that a focal length e times larger or smaller has to win over before it is
believed.
"""
WIDE_PREFERENCE = 0.05
"""The same for photos from wide apart, of whose few matches more are wrong."""
_SURE = 80.0  # score below which the matches never contradict what the user says of the lens
# share of the best score by which what the user says must be worse to be contradicted
_CLEAR = 0.08
_FAR = 0.3  # smallest error that is told of [log focal length]
_ASIDE = 0.35  # where a look aside tells whether there is anything to tell [log focal length]
_LEAST_SUPPORT = 15.0  # score below which the matches agree with no motion at all
_STEPS = (
    0.08,
    0.04,
    0.02,
    0.01,
)  # between two fields of view of the scan, shorter and shorter [log focal length]


def calibrate(
    images: Sequence[CalibratedImage],
    found: PointPairs,
    threshold: float,
    seed: int,
    preference: float = PREFERENCE,
) -> float | None:
    """The field of view that `images`, all taken to have the same one, agree on best; None with too
    few matches.

    It is measured across the longer side [degrees]. `threshold` is in pixels at a long side of 256.
    A focal length e times as large as what was assumed has to win over a share `preference` of the
    matches.
    """
    search = _search(images, found, threshold, seed, preference)
    if search is None:
        return None
    best = max(search.scan(), key=lambda trial: trial.score)
    if best.score < _LEAST_SUPPORT:
        return None
    for step in _STEPS:
        near = [
            search.with_poses_near(best.log_focal + sign * step, best.poses)
            for sign in (-1, 1)
        ]
        best = max(best, *near, key=lambda trial: trial.score)
    return search.fov(best.log_focal)


def contradiction(
    images: Sequence[CalibratedImage], found: PointPairs, threshold: float, seed: int
) -> float | None:
    """The field of view that photos tell [degrees] where the one they came with is surely wrong;
    else None.

    Sure: many matches agree clearly better with one far from it, and less again with the narrowest
    and the widest, so that the scene does tell. Photos of several lenses are taken to be wrong by
    one factor; it is that of the first.
    """
    search = _search(images, found, threshold, seed)
    if search is None or not search.doubted():
        return None
    given, *others = search.scan()
    best = max(others, key=lambda trial: trial.score)
    beyond = max(others[0].score, others[-1].score)
    clear = (
        given.score < (1 - _CLEAR) * best.score
        and beyond < (1 - _CLEAR / 2) * best.score
    )
    sure = clear and best.score >= _SURE and abs(best.log_focal - search.assumed) > _FAR
    return search.fov(best.log_focal) if sure else None


def _search(
    images: Sequence[CalibratedImage],
    found: PointPairs,
    threshold: float,
    seed: int,
    preference: float = PREFERENCE,
) -> "_FocalSearch | None":
    """A search on the pairs with most matches; None where no pair has enough."""
    richest = sorted(found.items(), key=lambda item: -len(item[1]))[:_MOST_PAIRS]
    pairs = [matches for _, matches in richest if len(matches) >= _FEWEST_MATCHES]
    longest = max(max(image.size) for image in images)
    return (
        _FocalSearch(pairs, longest, threshold * longest / 256, seed, preference)
        if pairs
        else None
    )


@dataclass(frozen=True)
class _Trial:
    """How well the matches agree with one focal length."""

    score: float  # higher is better
    log_focal: float  # [log pixels]
    poses: tuple[Pose | None, ...]  # one a pair


@dataclass(frozen=True)
class _FocalSearch:
    """Scores focal lengths by how well the matches agree with the best motion at each."""

    pairs: list[Matches]
    longest: int  # side [pixels]
    threshold: float  # [pixels]
    seed: int
    preference: float

    @property
    def assumed(self) -> float:
        """Log focal length that the pairs came with."""
        return math.log(self.pairs[0].focal)

    def log_focal(self, fov: float) -> float:
        return math.log(0.5 * self.longest / math.tan(math.radians(fov) / 2))

    def fov(self, log_focal: float) -> float:
        return math.degrees(2 * math.atan(0.5 * self.longest / math.exp(log_focal)))

    def doubted(self) -> bool:
        """Whether a lens a good deal longer or shorter than assumed does better: a fifth of a
        scan's time.
        """
        given = self.with_new_poses(self.assumed)
        others = [
            self.with_poses_near(self.assumed + sign * _ASIDE, given.poses)
            for sign in (-1, 1)
        ]
        again = [self.with_poses_near(self.assumed, other.poses) for other in others]
        return max(trial.score for trial in others) > max(
            trial.score for trial in (given, *again)
        )

    def scan(self) -> list[_Trial]:
        """What was assumed, then all fields of view from narrow to wide."""
        tried = [self.assumed, *(self.log_focal(fov) for fov in FIELDS_OF_VIEW)]
        scanned = [self.with_new_poses(log_focal) for log_focal in tried]
        best = max(scanned, key=lambda trial: trial.score)
        # A robust estimate may miss the motion at one focal length and find it at the next: all try
        # the best one's.
        again = [self.with_poses_near(trial.log_focal, best.poses) for trial in scanned]
        return [
            max(pair, key=lambda trial: trial.score) for pair in zip(scanned, again)
        ]

    def with_new_poses(self, log_focal: float) -> _Trial:
        """The score with poses found anew."""
        found = (
            rough_pose(self._with_focal(pair, log_focal), self.threshold, self.seed)
            for pair in self.pairs
        )
        return self._trial(log_focal, tuple(found))

    def with_poses_near(
        self, log_focal: float, poses: tuple[Pose | None, ...]
    ) -> _Trial:
        """The score with the poses of a nearby focal length, refined."""
        refined = (
            None
            if pose is None
            else refine(self._with_focal(pair, log_focal), pose, self.threshold)
            for pair, pose in zip(self.pairs, poses)
        )
        return self._trial(log_focal, tuple(refined))

    def _trial(self, log_focal: float, poses: tuple[Pose | None, ...]) -> _Trial:
        agreeing = sum(
            sharp_support(self._with_focal(pair, log_focal), pose, self.threshold)
            for pair, pose in zip(self.pairs, poses)
            if pose is not None
        )
        penalty = (
            self.preference
            * (log_focal - self.assumed) ** 2
            * sum(len(pair) for pair in self.pairs)
        )
        return _Trial(agreeing - penalty, log_focal, poses)

    def _with_focal(self, pair: Matches, log_focal: float) -> Matches:
        """The same points seen with another focal length."""
        return pair.zoomed(math.exp(log_focal - self.assumed))
