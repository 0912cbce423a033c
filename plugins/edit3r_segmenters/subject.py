"""What stands out most on a photo, by a small learned network, and how surely it is the subject."""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np

from edit3r.kit.compute.outlines import overlap
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD

SEEN = 320  # side of what the network sees, as it was trained [pixels]
# How surely what stands out is the subject, read off 42 photos (docs/notes/selecting.md)
CLEAR_AREA = 0.22  # share of the image
CLEAR_ASIDE = (0.2, 0.35)  # from the middle [sides]: still, and no longer
HIGHEST_CLEARNESS = 0.8  # of what ends clearly, and may be another thing than is meant


def clearness(salience: np.ndarray) -> float:
    """How surely what stands out (`[H, W]` in [0, 1]) is the one subject: the same at a low and a
    high threshold, in one piece, of a subject's size and not aside.
    """
    inside = salience > 0.5
    if not inside.any():
        return 0.0
    bits = inside.astype(np.uint8)
    areas = cv2.connectedComponentsWithStats(bits)[2][1:, cv2.CC_STAT_AREA]
    aside = [
        np.abs((np.nonzero(inside)[axis].mean() + 0.5) / side - 0.5)
        for axis, side in enumerate(inside.shape)
    ]
    clear = overlap(salience > 0.25, salience > 0.75) * areas.max() / areas.sum()
    clear *= np.interp(inside.mean(), (0, CLEAR_AREA), (0.4, 1))
    clear *= np.interp(max(aside), CLEAR_ASIDE, (1, 0.5))
    return float(HIGHEST_CLEARNESS * clear)


def reader(path: Path) -> Callable[[], cv2.dnn.Net]:
    """Reads the network when it is first asked for; its 0.25 GB are free once this is forgotten."""
    return cache(partial(cv2.dnn.readNetFromONNX, str(path)))


def salience(read: Callable[[], cv2.dnn.Net], pixels: np.ndarray) -> np.ndarray:
    """How much each pixel of uint8 RGB `[H, W, 3]` belongs to the subject by U²-Netp: float32 `[H,
    W]` in [0, 1].

    A small network (Qin et al. 2020) that OpenCV itself runs; its weights are optional (`edit3r
    weights get u2netp`). It sees the picture squashed to a square.
    """
    shrinks = max(pixels.shape[:2]) > SEEN
    way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    square = cv2.resize(pixels, (SEEN, SEEN), interpolation=way)
    mean, std = (np.array(one, np.float32) for one in (IMAGENET_MEAN, IMAGENET_STD))
    scaled = (square.astype(np.float32) / max(1, int(square.max())) - mean) / std
    network = read()
    network.setInput(np.ascontiguousarray(scaled.transpose(2, 0, 1)[None]))
    # the first is the fusion of all
    found = network.forward(network.getUnconnectedOutLayersNames()[0])[0, 0]
    return np.clip(cv2.resize(found, pixels.shape[1::-1]), 0, 1)
