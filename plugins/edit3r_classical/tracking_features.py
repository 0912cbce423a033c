"""Carry a mask to a view far away: SIFT matches on the object and the affine map they agree on."""

import cv2
import numpy as np

from edit3r_classical.segmenter_masks import distance_to

RATIO = 0.8  # Lowe's test: best match at most this share of the second best distance
MIN_MATCHES = 8  # agreeing matches without which the object counts as not found
AGREEMENT = 0.02  # distance from the affine map at which a match agrees [picture diagonals]
MAX_STRETCH = 3.0  # largest change of size between two views of an object


def warp_by_features(source: np.ndarray, target: np.ndarray, mask: np.ndarray) -> np.ndarray | None:
    """The source's bool mask on the target's grid; None when too few matches agree on one map. Grey uint8 pictures."""
    pairs = _matches(source, target, mask)
    if pairs is None or len(pairs[0]) < MIN_MATCHES:
        return None
    cv2.setRNGSeed(0)
    tolerance = AGREEMENT * float(np.hypot(*source.shape))
    matrix, agreeing = cv2.estimateAffine2D(*pairs, method=cv2.RANSAC, ransacReprojThreshold=tolerance, maxIters=5000)
    if matrix is None or int(agreeing.sum()) < MIN_MATCHES or not _is_plausible(matrix):
        return None
    height, width = target.shape
    return cv2.warpAffine(mask.astype(np.float32), matrix, (width, height), flags=cv2.INTER_LINEAR) > 0.5


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
    return bool(np.linalg.det(matrix[:, :2]) > 0 and stretch[0] < MAX_STRETCH and stretch[1] > 1 / MAX_STRETCH)
