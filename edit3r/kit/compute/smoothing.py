"""Smoothing of maps along the edges of an image."""

import threading

import cv2
import numpy as np
from jaxtyping import Float, UInt8

__all__ = ["weighted_smooth"]

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
