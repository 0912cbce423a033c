"""Pose of one camera relative to another from point matches.

pycolmap's robust estimate is refined on the Sampson error. Whether its support could be chance is
decided a contrario (Moisan and Stival 2004): how many such agreements would matches thrown at
random give?
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float

from edit3r.kit.geometry.quiet_pycolmap import pycolmap
from edit3r_geometry.cameras import Pose, cross_matrix, triangulate

# The numbers of this block: no figures kept.
MIN_INLIERS = 12
LEAST_SHARE = 0.3
"""Share of the matches that must agree on a motion which the estimate without the lens does not
show. No figure kept.
"""
REFINEMENT_ROUNDS = 3
_MOST_STEPS = 30
_SMALL_STEP = 1e-6  # by which slopes of the errors are read
_LEAST_GAIN = 1e-4  # share of the loss below which a step is the last
_NEAR = 1.5  # times the threshold: matches that take part in the refinement
# times the threshold: what a good match is off, where it is asked how exactly they agree
_SHARP = 0.15
# times the threshold: what points that are not wrong are off, for the loss
_NOISE = 0.25


@dataclass(frozen=True)
class Matches:
    """Points that look alike in two images, as camera-frame rays with z = 1."""

    rays_a: Float[np.ndarray, "match 3"]
    rays_b: Float[np.ndarray, "match 3"]
    focal: float  # mean focal length of the two cameras [pixels]: turns ray distances into pixels
    chance: float  # probability that a random match lies within one pixel of a given epipolar line
    # how inexact each is, 1 being SIFT's points; None: all are
    noise: Float[np.ndarray, "match"] | None = None

    def __len__(self) -> int:
        return len(self.rays_a)

    def select(self, index: Bool[np.ndarray, "match"]) -> "Matches":
        """The matches at `index`."""
        noise = None if self.noise is None else self.noise[index]
        return replace(
            self, rays_a=self.rays_a[index], rays_b=self.rays_b[index], noise=noise
        )

    def zoomed(self, factor: float) -> "Matches":
        """The same points seen with focal lengths `factor` times as long."""
        rays = (
            rays / np.array([factor, factor, 1.0])
            for rays in (self.rays_a, self.rays_b)
        )
        return replace(
            self, **dict(zip(("rays_a", "rays_b"), rays)), focal=factor * self.focal
        )


@dataclass(frozen=True)
class TwoViewPose:
    """The relative pose that matches agree on."""

    pose: Pose  # A's frame to B's, translation of length 1
    inliers: Bool[np.ndarray, "match"]
    # log10 of how many equally good agreements random matches would give
    log_false_alarms: float


def estimate_pose(
    matches: Matches, threshold: float, seed: int, once: bool = False
) -> TwoViewPose | None:
    """The pose that most matches agree on within `threshold` [pixels]; None when there is nothing
    to agree on.

    `once`: by one robust estimate instead of two, for one of many pairs.
    """
    pose = rough_pose(matches, threshold, seed, once)
    if pose is None:
        return None
    # The epipolar geometry does not tell the sign of the translation; points in front of both
    # cameras do.
    signed = [Pose(pose.rotation, sign * pose.translation) for sign in (1, -1)]
    scored = [(*support(matches, pose, threshold), pose) for pose in signed]
    _, inliers, pose = max(scored, key=lambda item: item[0])
    return TwoViewPose(
        pose,
        inliers,
        log_false_alarms(len(matches), int(inliers.sum()), matches.chance * threshold),
    )


def rough_pose(
    matches: Matches, threshold: float, seed: int, once: bool = False
) -> Pose | None:
    """The pose that pycolmap finds, refined, but for its translation's sign; None: none."""
    if len(matches) < MIN_INLIERS:
        return None
    focal = matches.focal
    camera = pycolmap.Camera(
        model="PINHOLE", width=1, height=1, params=[focal, focal, 0, 0]
    )
    options = pycolmap.TwoViewGeometryOptions(
        compute_relative_pose=True, detect_watermark=False, min_num_inliers=MIN_INLIERS
    )
    options.ransac.max_error, options.ransac.random_seed = threshold, seed
    first, second = (
        np.ascontiguousarray(focal * rays[:, :2])
        for rays in (matches.rays_a, matches.rays_b)
    )
    found = []
    if not once:
        same = np.repeat(np.arange(len(matches), dtype=np.uint32)[:, None], 2, axis=1)
        geometry = pycolmap.estimate_calibrated_two_view_geometry(
            camera, first, camera, second, same, options
        )
        if geometry.cam2_from_cam1 is None:
            return None
        found.append(geometry.cam2_from_cam1)
    # Where the lens is not quite what it is said to be, that explains the matches without it, and
    # its pose is wrong.
    essential = pycolmap.estimate_essential_matrix(
        first, second, camera, camera, options.ransac
    )
    least = 0.0 if once else LEAST_SHARE * len(matches)
    if essential is not None and essential["num_inliers"] >= least:
        found.append(essential["cam2_from_cam1"])
    matrices = [motion.matrix() for motion in found]
    lengths = [np.linalg.norm(matrix[:, 3]) for matrix in matrices]
    # Without a translation there are no epipolar lines.
    poses = [
        Pose(m[:, :3], m[:, 3] / length)
        for m, length in zip(matrices, lengths)
        if length > 1e-9
    ]
    refined = [refine(matches, pose, threshold) for pose in poses]
    return max(
        refined, key=lambda pose: signed_support(matches, pose, threshold), default=None
    )


def quick_pose(matches: Matches, threshold: float, seed: int) -> Pose | None:
    """As `rough_pose`, ten times as fast and less sure to find a motion that few matches share."""
    if len(matches) < MIN_INLIERS:
        return None
    focal = matches.focal
    points_a, points_b = (
        np.ascontiguousarray(focal * rays[:, :2])
        for rays in (matches.rays_a, matches.rays_b)
    )
    cv2.setRNGSeed(seed)
    essential, kept = cv2.findEssentialMat(
        points_a, points_b, focal, (0.0, 0.0), cv2.USAC_MAGSAC, 0.999, threshold
    )
    if essential is None or essential.shape != (3, 3):
        return None
    _, rotation, shift, _ = cv2.recoverPose(
        essential, points_a, points_b, focal=focal, pp=(0.0, 0.0), mask=kept
    )
    return refine(matches, Pose(rotation, shift[:, 0]), threshold, rounds=1)


def signed_support(matches: Matches, pose: Pose, threshold: float) -> float:
    """The larger `support` of the two signs of the translation: epipolar geometry tells it but for
    its sign, which points in front of both cameras tell.
    """
    return max(
        support(matches, Pose(pose.rotation, sign * pose.translation), threshold)[0]
        for sign in (1, -1)
    )


def sharp_support(matches: Matches, pose: Pose, threshold: float) -> float:
    """Score of `pose` like `signed_support`, by Cauchy's law: it also tells how exactly matches
    agree, not only that.

    1 a match on its epipolar line, half of that at about a third of the `threshold` [pixels], 0
    beyond it.
    """
    errors = sampson_errors(matches, pose)
    depth_a, depth_b = triangulate(matches.rays_a, matches.rays_b, pose)
    likely = np.log1p((threshold / (_SHARP * threshold)) ** 2) - np.log1p(
        (errors / (_SHARP * threshold)) ** 2
    )
    score = np.maximum(likely, 0) / np.log1p(_SHARP**-2)
    return float(
        max(
            score[(sign * depth_a > 0) & (sign * depth_b > 0)].sum() for sign in (1, -1)
        )
    )


def sampson_errors(matches: Matches, pose: Pose) -> Float[np.ndarray, "match"]:
    """Signed first-order distance of each match to the epipolar geometry [pixels]."""
    essential = cross_matrix(pose.translation) @ pose.rotation
    lines_b, lines_a = matches.rays_a @ essential.T, matches.rays_b @ essential
    products = np.einsum("ij,ij->i", matches.rays_b, lines_b)
    gradients = np.hstack((lines_a[:, :2], lines_b[:, :2]))
    squares = np.einsum("ij,ij->i", gradients, gradients)
    return matches.focal * products / np.sqrt(squares + 1e-18)


def support(
    matches: Matches, pose: Pose, threshold: float
) -> tuple[float, Bool[np.ndarray, "match"]]:
    """Truncated quadratic score (MSAC) of matches within `threshold` [pixels] and in front."""
    errors = sampson_errors(matches, pose)
    depth_a, depth_b = triangulate(matches.rays_a, matches.rays_b, pose)
    inliers = (np.abs(errors) < threshold) & (depth_a > 0) & (depth_b > 0)
    return float((1 - (errors[inliers] / threshold) ** 2).sum()), inliers


def refine(
    matches: Matches, pose: Pose, threshold: float, rounds: int = REFINEMENT_ROUNDS
) -> Pose:
    """Minimise the robust Sampson error; inliers are chosen anew between the `rounds`."""
    for _ in range(rounds):
        near = np.abs(sampson_errors(matches, pose)) < _NEAR * threshold
        if near.sum() < MIN_INLIERS:
            return pose
        pose = _settled(matches.select(near), pose, _NOISE * threshold)
    return pose


def _settled(matches: Matches, pose: Pose, scale: float) -> Pose:
    """The pose near `pose` of least Cauchy loss over `scale` [pixels] (Levenberg-Marquardt)."""
    scales = scale if matches.noise is None else scale * matches.noise
    errors, damping = sampson_errors(matches, pose) / scales, 1e-3
    for _ in range(_MOST_STEPS):
        weights = 1 / (1 + errors**2)
        beside = [_moved(pose, step) for step in _SMALL_STEP * np.eye(5)]
        grown = [sampson_errors(matches, one) / scales - errors for one in beside]
        slopes = np.stack(grown) / _SMALL_STEP
        normal, slope = (slopes * weights) @ slopes.T, slopes @ (weights * errors)
        damped = normal + np.diag(damping * normal.diagonal() + 1e-9)
        tried = _moved(pose, -np.linalg.solve(damped, slope))
        after = sampson_errors(matches, tried) / scales
        gain = 1 - np.log1p(after**2).sum() / np.log1p(errors**2).sum()
        damping = 0.1 * damping if gain > 0 else 10 * damping
        if gain > 0:
            pose, errors = tried, after
        if abs(gain) < _LEAST_GAIN or damping > 1e9:
            break
    return pose


def _slides(pose: Pose) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two directions in which the unit translation can move."""
    ahead = pose.translation
    aside = cross_matrix(ahead) @ np.eye(3)[np.abs(ahead).argmin()]
    aside /= np.linalg.norm(aside)
    return aside, cross_matrix(ahead) @ aside


def _moved(pose: Pose, step: Float[np.ndarray, "5"]) -> Pose:
    """A pose near `pose`: a step of a rotation vector and two slides of the unit translation."""
    slides = _slides(pose)
    translation = pose.translation + step[3] * slides[0] + step[4] * slides[1]
    rotation = cv2.Rodrigues(step[:3])[0] @ pose.rotation
    return Pose(rotation, translation / np.linalg.norm(translation))


def log_false_alarms(matches: int, inliers: int, chance: float) -> float:
    """log10 of the expected number of 5-point models on which chance has as many `inliers`."""
    if inliers <= 5:
        return np.inf
    choose = _log_binomial(matches, inliers) + _log_binomial(inliers, 5)
    return float(
        (np.log(10 * (matches - 5)) + choose + (inliers - 5) * np.log(min(chance, 1.0)))
        / np.log(10)
    )


def log_chance(matches: int, inliers: int, chance: float) -> float:
    """log10 of how likely at least `inliers` of random `matches` agree with a known motion, each by
    `chance` in (0, 1]; an upper bound.
    """
    return (
        _log_binomial(matches, inliers) + inliers * math.log(min(chance, 1.0))
    ) / math.log(10)


def _log_binomial(n: int, k: int) -> float:
    """Natural logarithm of the binomial coefficient."""
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def agreeing(
    first: Float[np.ndarray, "match 2"],
    second: Float[np.ndarray, "match 2"],
    threshold: float,
) -> Bool[np.ndarray, "match"] | None:
    """Return which matches agree with one epipolar geometry [pixels]; None where there is none.

    OpenCV raises where all that it drew is degenerate.
    """
    try:
        _, kept = cv2.findFundamentalMat(
            first, second, cv2.USAC_MAGSAC, threshold, 0.999, 2000
        )
    except cv2.error:
        return None
    return None if kept is None else kept[:, 0] > 0
