"""How much images show of the same, and the few that together show most of what all show.

Two images share what their features (ORB, Rublee et al. 2011) have in common. Photos are chosen
greedily, each time the one that shows most of what those chosen so far do not (facility location;
Krause and Golovin 2014, section 1).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

# The numbers of this block: no figures kept.
SIDE = 400  # longer side of the images that are compared [pixels]
FEATURES = 600  # of an image
MAX_HAMMING = 48  # bits of 256 in which the features of one point may differ
MIN_SHARED = 0.04  # share of features that two neighbours have in common


@dataclass(frozen=True)
class ImageFeatures:
    """What a small copy of an image shows."""

    points: Float[np.ndarray, "feature 2"]  # [image widths]
    descriptors: UInt8[np.ndarray, "feature 32"] | None
    sharpness: float  # variance of the Laplacian


def features_of(pixels: UInt8[np.ndarray, "height width 3"]) -> ImageFeatures:
    """Features and sharpness of an RGB image, measured on a copy of `SIDE` pixels."""
    scale = SIDE / max(pixels.shape[:2])
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY)
    orb = cv2.ORB.create(FEATURES, fastThreshold=7)
    keypoints, descriptors = orb.detectAndCompute(grey, None)  # None: no mask
    points = cv2.KeyPoint.convert(keypoints)
    points = np.reshape(points, (-1, 2)).astype(np.float64) / grey.shape[1]
    return ImageFeatures(points, descriptors, cv2.Laplacian(grey, cv2.CV_64F).var())


def motion(first: ImageFeatures, second: ImageFeatures) -> float:
    """Median displacement of what both show [image widths]; infinite where they share little."""
    pairs = _matches(first, second)
    if len(pairs) < max(1, MIN_SHARED * len(first.points)):
        return float("inf")
    moved = first.points[pairs[:, 0]] - second.points[pairs[:, 1]]
    return float(np.median(np.linalg.norm(moved, axis=1)))


def shared(images: Sequence[ImageFeatures]) -> Float[np.ndarray, "photo photo"]:
    """For each pair the share of features that both show, in [0, 1]; 1 on the diagonal."""
    result = np.eye(len(images))
    for i, first in enumerate(images):
        for j, second in enumerate(images[:i]):
            fewer = max(1, min(len(first.points), len(second.points)))
            result[i, j] = result[j, i] = len(_matches(first, second)) / fewer
    return result


def covering(common: Float[np.ndarray, "photo photo"], most: int) -> list[int]:
    """Indices, in order, of at most `most` photos that show most of what all show.

    Each is linked to another of them where that is possible.
    """
    chosen: list[int] = []
    best = np.zeros(len(common))  # how much of each photo those chosen show
    while len(chosen) < min(most, len(common)):
        gains = np.maximum(common - best[:, None], 0).sum(0)
        free = np.ones(len(common), bool)
        free[chosen] = False
        linked = free & (best >= MIN_SHARED)
        eligible = linked if linked.any() else free
        chosen.append(int(np.argmax(np.where(eligible, gains, -1))))
        best = np.maximum(best, common[:, chosen[-1]])
    return sorted(chosen)


def _matches(first: ImageFeatures, second: ImageFeatures) -> np.ndarray:
    """Index pairs of features that are each other's nearest and alike."""
    pairs = []
    if first.descriptors is not None and second.descriptors is not None:
        matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
        for match in matcher.match(first.descriptors, second.descriptors):
            if match.distance < MAX_HAMMING:
                pairs.append((match.queryIdx, match.trainIdx))
    return np.array(pairs, dtype=int).reshape(-1, 2)
