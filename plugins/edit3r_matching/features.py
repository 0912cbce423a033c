"""Point features and their matches: SIFT with the square-root descriptor (Arandjelovic and
Zisserman 2012).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, Int

__all__ = ["Keypoints", "detect", "match"]

_LARGEST_ENLARGEMENT = 4.0
_CONTRAST = 0.01  # of SIFT; low, because weak features still match when both ways agree
_EDGE = 15.0
# OpenCV's SIFT doubles the image first and forgets that this moves pixel centres
_DOUBLING_SHIFT = 0.25


@dataclass(frozen=True)
class Keypoints:
    """Where the features are and what they look like."""

    points: Float[
        np.ndarray, "point 2"
    ]  # x, y [pixels of the image, pixel centres at +0.5], float64
    descriptors: Float[np.ndarray, "point 128"]  # unit length, float32

    def __len__(self) -> int:
        return len(self.points)

    def followed_by(self, more: "Keypoints") -> "Keypoints":
        """These features, then `more` of the same image."""
        return Keypoints(
            *map(
                np.concatenate,
                ((self.points, more.points), (self.descriptors, more.descriptors)),
            )
        )


def detect(
    image: Float[np.ndarray, "height width 3"], limit: int, detection_size: int
) -> Keypoints:
    """At most about `limit` of the strongest features of `image` in [0, 1].

    SIFT looks at the image at a long side of `detection_size` [pixels]; a small one is enlarged, at
    most fourfold, which doubles the matches of images of 256 pixels.
    """
    grey = cv2.cvtColor(
        (np.clip(image, 0, 1) * 255).round().astype(np.uint8), cv2.COLOR_RGB2GRAY
    )
    scale = min(detection_size / max(grey.shape), _LARGEST_ENLARGEMENT)
    size = (max(1, round(grey.shape[1] * scale)), max(1, round(grey.shape[0] * scale)))
    filtering = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    sift = cv2.SIFT_create(limit, contrastThreshold=_CONTRAST, edgeThreshold=_EDGE)
    found, descriptors = sift.detectAndCompute(
        cv2.resize(grey, size, interpolation=filtering), None
    )
    if not found:
        return Keypoints(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    # SIFT counts from pixel centres, we from the corner; the two axes were scaled by slightly
    # different whole sizes.
    pixels = np.array([point.pt for point in found]) + 0.5 - _DOUBLING_SHIFT
    points = pixels * np.array(grey.shape[::-1]) / np.array(size)
    return Keypoints(points, _square_root(descriptors))


def _square_root(
    descriptors: Float[np.ndarray, "point 128"],
) -> Float[np.ndarray, "point 128"]:
    """The Hellinger kernel: normalise by the sum, then take the root; the result has unit
    length.
    """
    total = np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)
    return np.sqrt(descriptors / total).astype(np.float32)


def match(a: Keypoints, b: Keypoints, ratio: float) -> Int[np.ndarray, "match 2"]:
    """Pairs of indices that choose each other and whose second choice is clearly worse.

    A match stays when its descriptor distance is below `ratio` times that to the second-best in `b`
    (Lowe's test).
    """
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), int)
    similarity = a.descriptors @ b.descriptors.T
    rows, best = np.arange(len(a)), similarity.argmax(axis=1)
    first = similarity[rows, best]
    similarity[rows, best] = -1
    second = similarity.max(axis=1)
    similarity[rows, best] = first
    distinct = np.flatnonzero(_distance(first) < ratio * _distance(second))
    mutual = similarity[:, best[distinct]].argmax(axis=0) == distinct
    pairs = np.stack([distinct, best[distinct]], axis=1)[mutual]
    return _without_duplicates(a, b, pairs)


def _distance(similarity: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    """Distance of unit vectors; never quite 0, so that of two perfect matches neither is the better
    one.
    """
    return np.sqrt(np.maximum(2 - 2 * similarity, 1e-6))


def _without_duplicates(
    a: Keypoints, b: Keypoints, pairs: Int[np.ndarray, "match 2"]
) -> Int[np.ndarray, "distinct 2"]:
    """One match for each position: SIFT reports a point once per dominant orientation."""
    positions = np.round(
        np.concatenate([a.points[pairs[:, 0]], b.points[pairs[:, 1]]], axis=1), 1
    )
    _, kept = np.unique(positions, axis=0, return_index=True)
    return pairs[np.sort(kept)]
