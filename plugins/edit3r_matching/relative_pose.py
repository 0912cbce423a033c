"""Pose of one camera relative to another from point matches.

Several robust estimates of the essential matrix (OpenCV's USAC) are refined on the Sampson error and the one that
explains most matches with points in front of both cameras wins. Whether that could be chance is decided a contrario
(Moisan and Stival 2004): how many such agreements would matches thrown at random give?
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import least_squares
from scipy.special import gammaln

from edit3r_matching.cameras import Pose, cross_matrix, triangulate

__all__ = ["Matches", "TwoViewPose", "estimate_pose", "pose_fitted_once", "refine", "rough_pose", "signed_support"]

MIN_INLIERS = 12
_METHODS = (cv2.USAC_MAGSAC, cv2.USAC_ACCURATE)
_THRESHOLD_FACTORS = (0.5, 1.0)
_REFINED_CANDIDATES = 2
_REFINEMENT_ROUNDS = 3


@dataclass(frozen=True)
class Matches:
    """Points that look alike in two images, as camera-frame rays with z = 1."""

    rays_a: Float[np.ndarray, "match 3"]
    rays_b: Float[np.ndarray, "match 3"]
    focal: float  # mean focal length of the two cameras [pixels]: turns ray distances into pixels
    chance: float  # probability that a random match lies within one pixel of a given epipolar line

    def __len__(self) -> int:
        return len(self.rays_a)

    def select(self, index: Bool[np.ndarray, "match"]) -> "Matches":
        """The matches at `index`."""
        return replace(self, rays_a=self.rays_a[index], rays_b=self.rays_b[index])


@dataclass(frozen=True)
class TwoViewPose:
    """The relative pose that matches agree on."""

    pose: Pose  # A's frame to B's, translation of length 1
    inliers: Bool[np.ndarray, "match"]
    log_false_alarms: float  # log10 of how many equally good agreements random matches would give


def estimate_pose(matches: Matches, threshold: float, seed: int) -> TwoViewPose | None:
    """The pose that most matches agree on within `threshold` [pixels]; None when there is nothing to agree on."""
    if len(matches) < MIN_INLIERS:
        return None
    candidates = _essential_candidates(matches, threshold, seed)
    candidates.sort(key=lambda pose: _support(matches, pose, threshold)[0], reverse=True)
    refined = [refine(matches, pose, threshold) for pose in candidates[:_REFINED_CANDIDATES]]
    # The epipolar geometry does not tell the sign of the translation; points in front of both cameras do.
    signed = [Pose(pose.rotation, sign * pose.translation) for pose in refined for sign in (1, -1)]
    scored = [(*_support(matches, pose, threshold, in_front=True), pose) for pose in signed]
    if not scored:
        return None
    _, inliers, pose = max(scored, key=lambda item: item[0])
    return TwoViewPose(pose, inliers, _log_false_alarms(len(matches), int(inliers.sum()), matches.chance * threshold))


def rough_pose(matches: Matches, threshold: float, seed: int) -> Pose | None:
    """The pose by one robust estimate alone, refined, up to the sign of its translation; None where there is none."""
    if len(matches) < MIN_INLIERS:
        return None
    candidates = _essential_candidates(matches, threshold, seed, _METHODS[:1], (1.0,))
    return refine(matches, candidates[0], threshold) if candidates else None


def signed_support(matches: Matches, pose: Pose, threshold: float) -> float:
    """Score of `pose` with the sign of its translation for which more points lie in front of both cameras."""
    return max(
        _support(matches, Pose(pose.rotation, sign * pose.translation), threshold, in_front=True)[0] for sign in (1, -1)
    )


def _essential_candidates(
    matches: Matches,
    threshold: float,
    seed: int,
    methods: Sequence[int] = _METHODS,
    factors: Sequence[float] = _THRESHOLD_FACTORS,
) -> list[Pose]:
    """Robust estimates by several methods and thresholds; each finds the truth on some photos the others miss."""
    points_a, points_b = (np.ascontiguousarray(rays[:, :2]) for rays in (matches.rays_a, matches.rays_b))
    poses = []
    for method in methods:
        for factor in factors:
            cv2.setRNGSeed(seed)
            limit = factor * threshold / matches.focal
            try:
                essential, mask = cv2.findEssentialMat(
                    points_a, points_b, np.eye(3), method=method, prob=0.9999, threshold=limit, maxIters=5000
                )
            except cv2.error:
                continue  # USAC raises on some degenerate samples; the other estimates remain
            if essential is not None and essential.shape == (3, 3):
                _, rotation, translation, _ = cv2.recoverPose(essential, points_a, points_b, np.eye(3), mask=mask)
                poses.append(Pose(rotation, translation[:, 0]))
    return poses


def sampson_errors(matches: Matches, pose: Pose) -> Float[np.ndarray, "match"]:
    """Signed first-order distance of each match to the epipolar geometry [pixels]."""
    essential = cross_matrix(pose.translation) @ pose.rotation
    lines_b, lines_a = matches.rays_a @ essential.T, matches.rays_b @ essential
    gradient = (lines_b[:, :2] ** 2).sum(1) + (lines_a[:, :2] ** 2).sum(1)
    return matches.focal * (matches.rays_b * lines_b).sum(1) / np.sqrt(gradient + 1e-18)


def _support(
    matches: Matches, pose: Pose, threshold: float, in_front: bool = False
) -> tuple[float, Bool[np.ndarray, "match"]]:
    """Truncated quadratic score (MSAC, higher is better) and the matches within `threshold`."""
    errors = sampson_errors(matches, pose)
    inliers = np.abs(errors) < threshold
    if in_front:
        depth_a, depth_b = triangulate(matches.rays_a, matches.rays_b, pose)
        inliers &= (depth_a > 0) & (depth_b > 0)
    return float((1 - (errors[inliers] / threshold) ** 2).sum()), inliers


def refine(matches: Matches, pose: Pose, threshold: float) -> Pose:
    """Minimise the robust Sampson error over rotation and translation direction, reselecting inliers in between."""
    for _ in range(_REFINEMENT_ROUNDS):
        near = np.abs(sampson_errors(matches, pose)) < 2 * threshold
        if near.sum() < MIN_INLIERS:
            return pose
        kept = matches.select(near)
        moved = _tangent_step(pose)
        solution = least_squares(
            lambda step, kept=kept, moved=moved: sampson_errors(kept, moved(step)),
            np.zeros(5),
            loss="soft_l1",
            f_scale=0.3 * threshold,
        )
        pose = moved(solution.x)
    return pose


def pose_fitted_once(matches: Matches, pose: Pose) -> Pose:
    """Two Gauss-Newton steps from `pose` to where the Sampson errors are least; its baseline keeps its length."""
    length = np.linalg.norm(pose.translation)
    pose = Pose(pose.rotation, pose.translation / length)
    for _ in range(2):
        moved, errors = _tangent_step(pose), sampson_errors(matches, pose)
        slopes = np.stack([(sampson_errors(matches, moved(1e-5 * axis)) - errors) / 1e-5 for axis in np.eye(5)], 1)
        pose = moved(-np.linalg.lstsq(slopes, errors, rcond=1e-4)[0].clip(-0.05, 0.05))
    return Pose(pose.rotation, pose.translation * length)


def _tangent_step(pose: Pose) -> Callable[[Float[np.ndarray, "5"]], Pose]:
    """Function from 5 numbers (rotation vector, two slides of the unit translation) to a pose near `pose`."""
    slides = np.linalg.svd(pose.translation[None])[2][1:]

    def moved(step: Float[np.ndarray, "5"]) -> Pose:
        translation = pose.translation + step[3:] @ slides
        rotation = cv2.Rodrigues(step[:3])[0] @ pose.rotation
        return Pose(rotation, translation / np.linalg.norm(translation))

    return moved


def _log_false_alarms(matches: int, inliers: int, chance: float) -> float:
    """log10 of the expected number of 5-point models that `inliers` of random `matches` would agree with."""
    if inliers <= 5:
        return np.inf
    choose = _log_binomial(matches, inliers) + _log_binomial(inliers, 5)
    return float((np.log(10 * (matches - 5)) + choose + (inliers - 5) * np.log(min(chance, 1.0))) / np.log(10))


def _log_binomial(n: int, k: int) -> float:
    """Natural logarithm of the binomial coefficient."""
    return float(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))
