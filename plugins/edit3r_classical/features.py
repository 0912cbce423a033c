"""Point features and their matches: SIFT with the square-root descriptor (Arandjelovic and Zisserman 2012)."""

from dataclasses import dataclass

import cv2
import numpy as np

__all__ = ["Keypoints", "detect", "match"]

DETECTION_SIZE = 768
"""Long side at which SIFT looks; small photos are enlarged, at most fourfold, which doubles the matches at 256²."""

_CONTRAST = 0.01  # of SIFT; low, because weak features still match when both ways agree
_EDGE = 15.0


@dataclass(frozen=True)
class Keypoints:
    """Where the features are and what they look like."""

    points: np.ndarray  # [N, 2] x, y [pixels of the photo, pixel centres at +0.5], float64
    descriptors: np.ndarray  # [N, 128] unit length, float32

    def __len__(self) -> int:
        return len(self.points)


def detect(image: np.ndarray, limit: int) -> Keypoints:
    """At most about `limit` of the strongest features of `image` `[height, width, 3]` in [0, 1]."""
    grey = cv2.cvtColor((np.clip(image, 0, 1) * 255).round().astype(np.uint8), cv2.COLOR_RGB2GRAY)
    scale = min(DETECTION_SIZE / max(grey.shape), 4.0)
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    filtering = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    # Without the precise enlargement every point lies a quarter of a pixel off.
    sift = cv2.SIFT_create(limit, contrastThreshold=_CONTRAST, edgeThreshold=_EDGE, enable_precise_upscale=True)
    found, descriptors = sift.detectAndCompute(cv2.resize(grey, size, interpolation=filtering), None)
    if not found:
        return Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    # SIFT counts from pixel centres, we from the corner; the two axes were scaled by slightly different whole sizes.
    points = (np.array([point.pt for point in found]) + 0.5) * np.array(grey.shape[::-1]) / np.array(size)
    return Keypoints(points, _square_root(descriptors))


def _square_root(descriptors: np.ndarray) -> np.ndarray:
    """Hellinger kernel: L1-normalise, then take the root; the result has unit length."""
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
    return np.sqrt(descriptors / total).astype(np.float32)


def match(a: Keypoints, b: Keypoints, ratio: float) -> np.ndarray:
    """Pairs of indices `[M, 2]` that choose each other and whose second choice is clearly worse.

    A match stays when its descriptor distance is below `ratio` times that to the second-best in `b` (Lowe's test).
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), int)
    similarity = a.descriptors @ b.descriptors.T
    rows = np.arange(len(a))
    best = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[best] == rows
    first = similarity[rows, best]
    similarity[rows, best] = -1
    second = similarity.max(axis=1)
    distinct = _distance(first) < ratio * _distance(second)
    pairs = np.stack([rows, best], axis=1)[mutual & distinct]
    return _without_duplicates(a, b, pairs)


def _distance(similarity: np.ndarray) -> np.ndarray:
    """Between unit vectors; never quite 0, so that of two perfect matches neither is the better one."""
    return np.sqrt(np.maximum(2 - 2 * similarity, 1e-6))


def _without_duplicates(a: Keypoints, b: Keypoints, pairs: np.ndarray) -> np.ndarray:
    """One match a place: SIFT reports a point once per dominant orientation."""
    places = np.round(np.concatenate([a.points[pairs[:, 0]], b.points[pairs[:, 1]]], axis=1), 1)
    _, kept = np.unique(places, axis=0, return_index=True)
    return pairs[np.sort(kept)]
