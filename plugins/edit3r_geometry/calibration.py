"""Reads the field of view from the images themselves where nobody knows it.

A wrong focal length bends the epipolar geometry, and fewer matches agree with any camera motion. So
the focal length is looked for with which most matches agree: a scan over plausible fields of view,
then between the best neighbours. Photos without known intrinsics are taken to share one field of
view across their longer side. The pairs that are asked are those that can tell: many matches, all
over the picture, that no homography explains. What is known of lenses decides where the matches
hardly care, as when a camera only moved sideways; then the reading says so.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np

from edit3r_geometry.cameras import CalibratedImage, Pose
from edit3r_geometry.relative_pose import (
    REFINEMENT_ROUNDS,
    Matches,
    agreeing,
    quick_pose,
    refine,
    rough_pose,
    sharp_support,
)

FIELDS_OF_VIEW = (
    *(20.0, 25.0, 31.0, 38.0, 46.0, 55.0, 65.0),
    *(75.0, 85.0, 95.0, 104.0, 112.0, 119.0, 125.0),
)
"""Across the longer side [degrees], from a telephoto lens to an action camera. No figure kept."""

PointPairs = Mapping[tuple[int, int], Matches]
"""Matches of two images, their rays made with the intrinsics that the images have now."""

# The numbers of this block: no figures kept.
_MOST_PAIRS = 4
_MOST_MATCHES = 400  # of a pair that are asked
_FEWEST_MATCHES = 40
USUAL_FOV = 66.0
"""The middle of usual fields of view [degrees]. Across the 36 mm of a full frame the main cameras
of phones (24 to 28 mm in its terms, as their makers state them) have 74 to 65 degrees, zooms that
come with cameras (18 to 55 mm before APS-C, 27 to 83 mm in its terms) 67 to 25, a cropped video a
tenth less than photos; phones' second, ultra-wide ones (13 mm) and action cameras 90 to 120.
Chosen: docs/notes/classical.md.
"""
USUAL_SPREAD, FEW, FEW_SPREAD = 0.25, 0.3, 0.6
"""Spread of most lenses about it [log focal length]; the share of the others, and their spread:
fitted with whole places left out (docs/notes/classical.md).
"""
_LEANING = 0.01
"""Share of the matches that a focal length e times what the user gave has to win over.
No figure kept.
"""
APART = 0.45
"""Lenses so far apart are two answers [log focal length]: 46 and 66 degrees, or 66 and 91.
No figure kept.
"""
ALIKE = 0.4
"""Matches by which another answer must be worse, times the root of all that are asked: the unit of
their likelihood's logarithm. No figure kept.
"""
_SURE = 80.0  # score below which the matches never contradict what the user says of the lens
# share of the best score by which what the user says must be worse to be contradicted
_CLEAR = 0.08
_FAR = 0.3  # smallest error that is told of [log focal length]
_ASIDE = 0.35  # where a look aside tells whether there is anything to tell [log focal length]
_LEAST_SUPPORT = 15.0  # score below which the matches agree with no motion at all
# between two fields of view of the scan, shorter and shorter [log focal length]
_STEPS = (0.08, 0.04, 0.02, 0.01)


@dataclass(frozen=True)
class LensReading:
    """The field of view that photos tell, across the longer side [degrees]."""

    fov: float
    alike: tuple[float, float] | None = None
    """The narrowest and the widest that explain the matches as well, where they are far apart."""


def calibrate(
    images: Sequence[CalibratedImage], found: PointPairs, threshold: float, seed: int
) -> LensReading | None:
    """The likeliest field of view of `images`, all taken to have the same one, by what their
    matches and what is known of lenses say; None with too few matches.

    `threshold` is in pixels at a long side of 256.
    """
    search = _search(images, found, threshold, seed, usual=True)
    if search is None:
        return None
    scanned = search.scan()
    best = max(scanned, key=lambda trial: trial.score)
    if best.support < _LEAST_SUPPORT:
        return None
    best = search.between(best)
    most = max(one.support for one in (best, *scanned))
    alike = [one for one in scanned if one.support >= most - search.unit]
    likely = [best.log_focal, *(one.log_focal for one in alike)]
    longest, shortest = max(likely), min(likely)
    unsure = max(longest - best.log_focal, best.log_focal - shortest) >= APART
    span = search.fov(longest), search.fov(shortest)
    return LensReading(search.fov(best.log_focal), span if unsure else None)


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
    place = max(range(len(others)), key=lambda index: others[index].score)
    if place in (0, len(others) - 1):  # still better beyond: nothing is told
        return None
    best = search.between(others[place])
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
    usual: bool = False,
) -> "_FocalSearch | None":
    """A search on the pairs that can tell most; None where no pair has enough matches.

    `usual`: beside the matches by what lenses usually have, not by what was given.
    """
    longest = max(max(image.size) for image in images)
    limit = threshold * longest / 256
    enough = [matches for matches in found.values() if len(matches) >= _FEWEST_MATCHES]
    if not enough:
        return None
    told = [_telling(matches, limit) for matches in enough]
    most = np.argsort(told)[::-1][:_MOST_PAIRS]
    shares = np.array([told[pair] / len(enough[pair]) for pair in most])
    weights = tuple((shares / max(shares.mean(), 1e-9)).tolist())
    pairs = [_sample(enough[pair]) for pair in most]
    return _FocalSearch(pairs, weights, longest, limit, seed, usual)


def _telling(matches: Matches, threshold: float) -> float:
    """How many matches agree with an epipolar geometry but with no homography.

    A homography explains a flat scene and a camera that only turned: they tell little or nothing.
    """
    first, second = (
        np.ascontiguousarray(matches.focal * rays[:, :2])
        for rays in (matches.rays_a, matches.rays_b)
    )
    kept = agreeing(first, second, threshold)
    if kept is None:
        return 0.0
    _, flat = cv2.findHomography(
        first, second, cv2.USAC_MAGSAC, 2 * threshold, maxIters=1000
    )
    deep = kept if flat is None else kept & (flat[:, 0] == 0)
    return float(deep.sum() + 0.1 * kept.sum())


def _sample(matches: Matches) -> Matches:
    """At most so many of the matches, evenly from all."""
    if len(matches) <= _MOST_MATCHES:
        return matches
    chosen = np.zeros(len(matches), bool)
    chosen[np.linspace(0, len(matches) - 1, _MOST_MATCHES).round().astype(int)] = True
    return matches.select(chosen)


@dataclass(frozen=True)
class _Trial:
    """How well the matches agree with one focal length."""

    log_focal: float  # [log pixels]
    supports: tuple[float, ...]  # of each pair; higher is better
    poses: tuple[Pose | None, ...]  # of each pair
    penalty: float  # of its distance from what is usual, or was given

    @property
    def support(self) -> float:
        return sum(self.supports)

    @property
    def score(self) -> float:
        return self.support - self.penalty

    def or_better(self, other: "_Trial") -> "_Trial":
        """Of two trials of one focal length the better motion of each pair."""
        pairs = zip(zip(self.supports, self.poses), zip(other.supports, other.poses))
        best = [max(both, key=lambda one: one[0]) for both in pairs]
        supports, poses = zip(*best)
        return replace(self, supports=supports, poses=poses)


@dataclass(frozen=True)
class _FocalSearch:
    """Scores focal lengths by how well the matches agree with the best motion at each."""

    pairs: list[Matches]
    weights: tuple[float, ...]  # of each pair, in the mean 1: how much of it tells
    longest: int  # side [pixels]
    threshold: float  # [pixels]
    seed: int
    usual: bool

    @property
    def assumed(self) -> float:
        """Log focal length that the pairs came with."""
        return math.log(self.pairs[0].focal)

    @property
    def asked(self) -> float:
        """How many matches are asked, those of telling pairs counting more."""
        return sum(w * len(pair) for w, pair in zip(self.weights, self.pairs))

    @property
    def unit(self) -> float:
        """Matches by which one lens is likelier than another by a factor of e."""
        return ALIKE * math.sqrt(self.asked)

    def log_focal(self, fov: float) -> float:
        return math.log(0.5 * self.longest / math.tan(math.radians(fov) / 2))

    def fov(self, log_focal: float) -> float:
        return math.degrees(2 * math.atan(0.5 * self.longest / math.exp(log_focal)))

    def doubted(self) -> bool:
        """Whether a lens much longer or shorter than assumed is better, in a fifth of a scan."""
        given = self.with_new_poses(self.assumed)
        aside = [self.assumed + sign * _ASIDE for sign in (-1, 1)]
        others = [
            self.with_poses_near(one, given.poses).or_better(self.with_new_poses(one))
            for one in aside
        ]
        again = [self.with_poses_near(self.assumed, other.poses) for other in others]
        return max(trial.score for trial in others) > max(
            trial.score for trial in (given, *again)
        )

    def scan(self) -> list[_Trial]:
        """What was assumed, then all fields of view from narrow to wide."""
        tried = [self.assumed, *(self.log_focal(fov) for fov in FIELDS_OF_VIEW)]
        trials = {log_focal: self.with_new_poses(log_focal) for log_focal in tried}
        # Quick estimates may all miss the motion; a surer one is asked once. Each focal length
        # tries its neighbours' motions, on the way to the widest and back.
        surer = (rough_pose(pair, self.threshold, self.seed) for pair in self.pairs)
        trials[self.assumed] = trials[self.assumed].or_better(
            self._trial(self.assumed, tuple(surer))
        )
        order = sorted(trials)
        for way in (order, order[::-1]):
            for before, log_focal in pairwise(way):
                near = self.with_poses_near(log_focal, trials[before].poses)
                trials[log_focal] = trials[log_focal].or_better(near)
        return [trials[log_focal] for log_focal in tried]

    def between(self, best: _Trial) -> _Trial:
        """The best trial between the neighbours of the `best` of a scan."""
        for step in _STEPS:
            near = [
                self.with_poses_near(
                    best.log_focal + sign * step, best.poses, REFINEMENT_ROUNDS
                )
                for sign in (-1, 1)
            ]
            best = max(best, *near, key=lambda trial: trial.score)
        return best

    def with_new_poses(self, log_focal: float) -> _Trial:
        """The score with poses found anew."""
        found = (
            quick_pose(self._with_focal(pair, log_focal), self.threshold, self.seed)
            for pair in self.pairs
        )
        return self._trial(log_focal, tuple(found))

    def with_poses_near(
        self, log_focal: float, poses: tuple[Pose | None, ...], rounds: int = 1
    ) -> _Trial:
        """The score with the poses of a nearby focal length, refined in so many `rounds`."""
        refined = (
            None
            if pose is None
            else refine(self._with_focal(pair, log_focal), pose, self.threshold, rounds)
            for pair, pose in zip(self.pairs, poses)
        )
        return self._trial(log_focal, tuple(refined))

    def _trial(self, log_focal: float, poses: tuple[Pose | None, ...]) -> _Trial:
        supports = tuple(
            0.0
            if pose is None
            else weight
            * sharp_support(self._with_focal(pair, log_focal), pose, self.threshold)
            for pair, weight, pose in zip(self.pairs, self.weights, poses)
        )
        return _Trial(log_focal, supports, poses, self._penalty(log_focal))

    def _penalty(self, log_focal: float) -> float:
        """What `log_focal` loses before any match is asked [matches]."""
        if not self.usual:
            return _LEANING * (log_focal - self.assumed) ** 2 * self.asked
        off = log_focal - self.log_focal(USUAL_FOV)
        usual, rare = (
            share / spread * math.exp(-0.5 * (off / spread) ** 2)
            for share, spread in ((1 - FEW, USUAL_SPREAD), (FEW, FEW_SPREAD))
        )
        return -self.unit * math.log(usual + rare)

    def _with_focal(self, pair: Matches, log_focal: float) -> Matches:
        """The same points seen with another focal length."""
        return pair.zoomed(math.exp(log_focal - self.assumed))
