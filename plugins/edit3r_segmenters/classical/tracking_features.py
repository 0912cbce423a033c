"""Find an object in a view far away: SIFT matches on it and the affine map they agree on."""

import cv2
import numpy as np

from edit3r_segmenters.classical.segmenter_masks import distance_to

RATIO = 0.8  # Lowe's test: best match at most this share of the second best distance
MIN_MATCHES = 8  # agreeing matches without which the object counts as not found
AGREEMENT = 0.02  # distance from the affine map at which a match agrees [picture diagonals]
MAX_STRETCH = 3.0  # largest change of size between two views of an object
MAX_SQUEEZE = 2.0  # largest ratio of the stretches along two axes: a surface seen 60 degrees from the side
FREEDOM_PRICE = 1.25  # an affine map must win this many times the matches of a similarity to be preferred


def affine_between(source: np.ndarray, target: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
    """`[2, 3]` affine map from the source's object to the target; None when too few matches agree on a plausible one.

    Grey uint8 pictures, bool mask. A similarity is taken unless an affine map explains clearly more matches.
    """
    pairs = _matches(source, target, mask)
    if pairs is None or len(pairs[0]) < MIN_MATCHES:
        return None
    tolerance = AGREEMENT * float(np.hypot(*source.shape))
    similarity, agreeing = _fit(cv2.estimateAffinePartial2D, pairs, tolerance)
    affine, more_agreeing = _fit(cv2.estimateAffine2D, pairs, tolerance)
    matrix, count = (affine, more_agreeing) if more_agreeing > FREEDOM_PRICE * agreeing else (similarity, agreeing)
    return matrix if count >= MIN_MATCHES else None


def _fit(estimate, pairs: tuple[np.ndarray, np.ndarray], tolerance: float) -> tuple[np.ndarray | None, int]:
    """A map and how many matches agree with it; none when it is not plausible."""
    cv2.setRNGSeed(0)
    matrix, agreeing = estimate(*pairs, method=cv2.RANSAC, ransacReprojThreshold=tolerance, maxIters=5000)
    return (matrix, int(agreeing.sum())) if matrix is not None and _is_plausible(matrix) else (None, 0)


def _matches(source: np.ndarray, target: np.ndarray, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Matching positions `[M, 2]` of the object's features in both views."""
    sift = cv2.SIFT_create(nfeatures=4000, contrastThreshold=0.02)
    on_object = (distance_to(mask) <= 3).astype(np.uint8)
    first, first_descriptors = sift.detectAndCompute(source, on_object)
    second, second_descriptors = sift.detectAndCompute(target, None)
    if first_descriptors is None or second_descriptors is None or len(second) < 2:
        return None
    candidates = cv2.BFMatcher().knnMatch(first_descriptors, second_descriptors, k=2)
    good = [best for best, other in candidates if best.distance < RATIO * other.distance]
    here = np.array([first[match.queryIdx].pt for match in good], np.float32).reshape(-1, 2)
    there = np.array([second[match.trainIdx].pt for match in good], np.float32).reshape(-1, 2)
    return here, there


def _is_plausible(matrix: np.ndarray) -> bool:
    """Neither mirrored nor stretched beyond what a change of viewpoint does."""
    stretch = np.linalg.svd(matrix[:, :2], compute_uv=False)
    bounded = stretch[0] < MAX_STRETCH and stretch[1] > 1 / MAX_STRETCH and stretch[0] < MAX_SQUEEZE * stretch[1]
    return bool(bounded and np.linalg.det(matrix[:, :2]) > 0)
