"""What an edit did to pictures: how much changed, how much of what was wished arrived, and what changed beside it.

Fréchet and kernel distances to the unedited pictures reward doing nothing; these three do not. Pictures are NumPy
arrays `[view, height, width, 3]`, sRGB in [0, 1]; masks `[view, height, width]` in [0, 1], 1 where the edit belongs.
"""

import numpy as np
from scipy.ndimage import gaussian_filter

__all__ = ["SMOOTHING", "change_outside", "edit_strength", "edit_uptake"]

SMOOTHING = 0.015
"""Standard deviation of the low-pass before pictures are compared [picture widths]: a rendering that is a little
blurred or shifted has not been edited."""


def edit_strength(shown: np.ndarray, photos: np.ndarray, masks: np.ndarray | None = None) -> float:
    """Mean absolute change from photo to `shown` inside the masks (everywhere without), after a low-pass [sRGB].

    0 when nothing was done; NaN when the masks are empty.
    """
    return _weighted_change(shown, photos, np.ones(photos.shape[:3]) if masks is None else masks)


def change_outside(shown: np.ndarray, photos: np.ndarray, masks: np.ndarray) -> float:
    """Mean absolute change outside the masks, after a low-pass [sRGB]; NaN when they leave nothing outside.

    Holds the errors of the reconstruction as well as what the edit spilled: compare with another method's.
    """
    return _weighted_change(shown, photos, (masks == 0).astype(np.float64))


def edit_uptake(shown: np.ndarray, photos: np.ndarray, edited: np.ndarray, masks: np.ndarray | None = None) -> float:
    """Share of the wished change (`edited` - `photos`) that `shown` has: its projection on it, inside the masks.

    1: all of it; 0: none, or something unrelated; below 0: the opposite. 0 when no change was wished. Blur and
    noise that have nothing to do with the wish count for nothing.
    """
    wished, found = edited - photos, shown - photos
    weight = 1.0 if masks is None else masks[..., None]
    energy = float((weight * wished**2).sum())
    return float((weight * wished * found).sum()) / energy if energy > 0 else 0.0


def _weighted_change(shown: np.ndarray, photos: np.ndarray, weight: np.ndarray) -> float:
    total = float(weight.sum())
    if total == 0:
        return float("nan")
    sigma = SMOOTHING * photos.shape[2]
    difference = gaussian_filter(shown - photos, (0, sigma, sigma, 0))
    return float((np.abs(difference).mean(-1) * weight).sum() / total)
