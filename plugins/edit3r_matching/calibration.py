"""Reads the field of view from the images themselves where nobody knows it.

A wrong focal length bends the epipolar geometry, and fewer matches agree with any camera motion. So the focal length
is looked for with which most matches agree: a scan over plausible fields of view, then between the best neighbours.
Photos without known intrinsics are taken to share one field of view across their longer side. A weak preference for
what was assumed decides where the matches do not care, as when a camera only moved sideways.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from edit3r_matching.cameras import CalibratedImage, Pose
from edit3r_matching.relative_pose import Matches, refine, rough_pose, signed_support

__all__ = ["Calibration", "PointPairs", "calibrate"]

FIELDS_OF_VIEW = (28.0, 36.0, 46.0, 57.0, 68.0, 80.0, 94.0)
"""Across the longer side [degrees], from a short telephoto lens to an action camera."""

PointPairs = Mapping[tuple[int, int], Matches]
"""Matches of two images, their rays made with the intrinsics that the images have now."""

_MOST_PAIRS = 2
_FEWEST_MATCHES = 40
_PREFERENCE = 0.01
"""Share of the matches that a focal length e times larger or smaller has to win over before it is believed."""
_LEAST_SUPPORT = 15.0  # score below which the matches agree with no motion at all
_HALF_STEP = 0.15  # between two fields of view of the scan [log focal length]
_LOG_FOCAL_TOLERANCE = 0.01


@dataclass(frozen=True)
class Calibration:
    """What was read from the images."""

    fov: float  # across the longer side [degrees]
    support: float  # score of the best camera motion with this field of view
    assumed_support: float  # and with the one that was assumed


def calibrate(images: Sequence[CalibratedImage], found: PointPairs, threshold: float, seed: int) -> Calibration | None:
    """The field of view that `images`, all taken to have the same one, agree on best; None with too few matches.

    `threshold` is in pixels at a long side of 256.
    """
    richest = sorted(found.items(), key=lambda item: -len(item[1]))[:_MOST_PAIRS]
    pairs = [matches for _, matches in richest if len(matches) >= _FEWEST_MATCHES]
    if not pairs:
        return None
    longest = max(max(image.size) for image in images)
    trials = _Trials(pairs, longest, threshold * longest / 256, seed)
    assumed = trials.scan(trials.assumed)
    scanned = [assumed, *(trials.scan(trials.log_focal(fov)) for fov in FIELDS_OF_VIEW)]
    best = max(scanned, key=lambda trial: trial.score)
    # A robust estimate may miss the motion at one focal length and find it at the next: all are tried with the best.
    again = [trials.near(trial.log_focal, best.poses) for trial in scanned]
    best = max(best, *again, key=lambda trial: trial.score)
    if best.score < _LEAST_SUPPORT:
        return None
    narrowed = minimize_scalar(
        lambda log_focal: -trials.near(log_focal, best.poses).score,
        bounds=(best.log_focal - _HALF_STEP, best.log_focal + _HALF_STEP),
        method="bounded",
        options={"xatol": _LOG_FOCAL_TOLERANCE},
    )
    log_focal = float(narrowed.x) if -narrowed.fun > best.score else best.log_focal
    return Calibration(trials.fov(log_focal), max(-float(narrowed.fun), best.score), max(assumed.score, again[0].score))


@dataclass(frozen=True)
class _Trial:
    """How well the matches agree with one focal length."""

    score: float  # higher is better
    log_focal: float  # [log pixels]
    poses: tuple[Pose | None, ...]  # one a pair


@dataclass(frozen=True)
class _Trials:
    """Scores of focal lengths, higher is better."""

    pairs: list[Matches]
    longest: int  # side [pixels]
    threshold: float  # [pixels]
    seed: int

    @property
    def assumed(self) -> float:
        """Log focal length that the pairs came with."""
        return math.log(self.pairs[0].focal)

    def log_focal(self, fov: float) -> float:
        return math.log(0.5 * self.longest / math.tan(math.radians(fov) / 2))

    def fov(self, log_focal: float) -> float:
        return math.degrees(2 * math.atan(0.5 * self.longest / math.exp(log_focal)))

    def scan(self, log_focal: float) -> _Trial:
        """With poses found anew."""
        found = (rough_pose(self._seen(pair, log_focal), self.threshold, self.seed) for pair in self.pairs)
        return self._trial(log_focal, tuple(found))

    def near(self, log_focal: float, poses: tuple[Pose | None, ...]) -> _Trial:
        """With the poses of a nearby focal length, refined."""
        refined = (
            None if pose is None else refine(self._seen(pair, log_focal), pose, self.threshold)
            for pair, pose in zip(self.pairs, poses)
        )
        return self._trial(log_focal, tuple(refined))

    def _trial(self, log_focal: float, poses: tuple[Pose | None, ...]) -> _Trial:
        agreeing = sum(
            signed_support(self._seen(pair, log_focal), pose, self.threshold)
            for pair, pose in zip(self.pairs, poses)
            if pose is not None
        )
        doubt = _PREFERENCE * (log_focal - self.assumed) ** 2 * sum(len(pair) for pair in self.pairs)
        return _Trial(agreeing - doubt, log_focal, poses)

    def _seen(self, pair: Matches, log_focal: float) -> Matches:
        """The same points through a lens of another focal length."""
        stretch = np.array([1.0, 1.0, math.exp(log_focal) / pair.focal])
        rays = (rays * stretch / stretch[2] for rays in (pair.rays_a, pair.rays_b))
        return replace(pair, **dict(zip(("rays_a", "rays_b"), rays)), focal=math.exp(log_focal))
