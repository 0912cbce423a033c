"""Computing whose answers do not depend on the number of threads."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from torch import Tensor

__all__ = [
    "bilinear",
    "one_thread",
    "weighted_smooth",
]


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread of torch inside (also a decorator): sums by index else differ."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@one_thread()
def bilinear(
    x: Float[Tensor, "batch channel height width"], size: tuple[int, int]
) -> Float[Tensor, "batch channel height2 width2"]:
    """Resize between pixel centres; torch's own rounds otherwise where threads share a picture."""
    return F.interpolate(x, size, mode="bilinear", align_corners=False)


PARTS = 2  # of the columns: each number of parts rounds otherwise, so every machine takes this one
ALONE = threading.Lock()  # the number of OpenCV's threads belongs to the whole process


def weighted_smooth(
    values: Float[np.ndarray, "height width"],
    weights: Float[np.ndarray, "height width"],
    guide: UInt8[np.ndarray, "height width 3"],
    strength: float,
    colour: float,
) -> Float[np.ndarray, "height width"]:
    """Mean of `values` by `weights` along the edges of the guide.

    The fast global smoother (Min et al. 2014): `colour` is the 8-bit difference at which the
    smoothness `strength` falls to 1/e. The same bits for any number of threads.
    """
    with ALONE:
        threads = cv2.getNumThreads()
        cv2.setNumThreads(PARTS)
        try:
            smoother = cv2.ximgproc.createFastGlobalSmootherFilter(
                guide, strength, colour
            )
            total = smoother.filter(weights)
            smooth = smoother.filter(values * weights)
        finally:
            cv2.setNumThreads(threads)
    return smooth / np.maximum(total, 1e-8)
