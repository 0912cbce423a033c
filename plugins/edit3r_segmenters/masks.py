"""Masks whose outlines follow the image: graph cut, small parts and holes."""

import cv2
import numpy as np

SMALLEST_PART = 0.03  # share of an object under which a separate piece of it is dropped
SMALLEST_HOLE = 0.01  # share under which a hole is filled
MIN_SAMPLES = 16  # pixels either side needs for a colour model


def graph_cut(image: np.ndarray, trimap: np.ndarray, rounds: int = 3) -> np.ndarray:
    """Run grabCut on float RGB `[H, W, 3]` in [0, 1] from a trimap `[H, W]` of cv2's GC_ values; a
    side too small for a colour model stays as it is.
    """
    foreground = (trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD)
    if min(foreground.sum(), (~foreground).sum()) < MIN_SAMPLES:
        return foreground
    labels = trimap.copy()
    cv2.setRNGSeed(0)  # its colour models start from k-means
    cv2.grabCut(
        to_bytes(image),
        labels,
        (0, 0, 0, 0),
        np.zeros((1, 65)),
        np.zeros((1, 65)),
        rounds,
        cv2.GC_INIT_WITH_MASK,
    )
    return (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)


def tidied(
    mask: np.ndarray, seed: np.ndarray, smallest: float = SMALLEST_PART
) -> np.ndarray:
    """Drop crumbs of a bool mask and pieces that miss the mask `seed`, and fill its small holes;
    all `[H, W]`. Crumbs are less than the share `smallest` of the mask.
    """
    total = mask.sum()
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=8
    )
    touched = np.bincount(labels[seed & mask], minlength=count) > 0
    kept = touched & (stats[:, cv2.CC_STAT_AREA] > smallest * total)
    kept[0] = False
    result = kept[labels]
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~result).astype(np.uint8), connectivity=4
    )
    holes = stats[:, cv2.CC_STAT_AREA] < SMALLEST_HOLE * total
    holes[0] = False
    return result | holes[labels]


def reduced(image: np.ndarray, size: int) -> np.ndarray:
    """Shrink a float image `[H, W, 3]` in [0, 1] so that its longer side is at most `size`
    [pixels].
    """
    height, width = image.shape[:2]
    factor = size / max(height, width)
    if factor >= 1:
        return image
    shape = max(1, round(width * factor)), max(1, round(height * factor))
    return np.clip(cv2.resize(image, shape, interpolation=cv2.INTER_AREA), 0, 1)


def to_bytes(image: np.ndarray) -> np.ndarray:
    """Round a float image `[H, W, 3]` in [0, 1] to uint8."""
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
