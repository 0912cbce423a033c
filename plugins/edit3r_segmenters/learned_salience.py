"""What stands out in a picture, by a small learned network (U²-Netp, Qin et al. 2020) that OpenCV itself runs.

The weights are optional: `edit3r weights get u2netp`. The network tells the subject of a picture; of a crop around a
click it tells the thing under the click.
"""

from functools import cache
from pathlib import Path

import cv2
import numpy as np

MEAN = np.array([0.485, 0.456, 0.406], np.float32)
STD = np.array([0.229, 0.224, 0.225], np.float32)


@cache
def _network(path: Path):
    return cv2.dnn.readNetFromONNX(str(path))


def salience(path: Path, pixels: np.ndarray, side: int) -> np.ndarray:
    """How much each pixel of uint8 RGB `[H, W, 3]` belongs to the subject: float32 `[H, W]` in [0, 1].

    The network sees the picture squashed to `side` x `side`; it was trained at 320, and half of that is a quarter of
    the time and enough for a crop with one thing in it.
    """
    shrinks = max(pixels.shape[:2]) > side
    square = cv2.resize(pixels, (side, side), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
    scaled = (square.astype(np.float32) / max(1, int(square.max())) - MEAN) / STD
    network = _network(path)
    network.setInput(np.ascontiguousarray(scaled.transpose(2, 0, 1)[None]))
    found = network.forward(network.getUnconnectedOutLayersNames()[0])[0, 0]  # the first is the fusion of all
    return np.clip(cv2.resize(found, pixels.shape[1::-1]), 0, 1)
