"""Masks whose outlines follow the image: graph cut, small parts and holes."""

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import cv2
import numpy as np

from edit3r.kit.compute.outlines import distance_to, window_around

SMALLEST_PART = 0.03  # share of an object under which a separate piece of it is dropped
SMALLEST_HOLE = 0.01  # share under which a hole is filled
MIN_SAMPLES = 16  # pixels either side needs for a colour model

Known = TypeVar("Known")


def snapped(
    image: np.ndarray,
    mask: np.ndarray,
    shrink: float,
    grow: float,
    rounds: int = 3,
    unsure: np.ndarray | None = None,
) -> np.ndarray:
    """Move the outline of a bool mask `[H, W]` to colour boundaries by graph cut (grabCut, Rother
    et al. 2004).

    `image` is uint8 RGB `[H, W, 3]`. The answer keeps the mask's core (eroded by `shrink`) and
    stays within its surroundings (dilated by `grow`), both in units of the square root of its area;
    pixels of the mask `unsure` are left to their colours. Deterministic.
    """
    if not mask.any():
        return mask
    size = np.sqrt(mask.sum())
    shrink, grow = max(1.0, shrink * size), max(1.0, grow * size)
    # enough of what surrounds it for a colour model, and no more to compute
    window = window_around(mask, 2 * grow + 8)
    part = mask[window]
    outwards, inwards = distance_to(part), distance_to(~part)
    trimap = np.full(part.shape, cv2.GC_BGD, np.uint8)
    trimap[outwards <= grow] = cv2.GC_PR_BGD
    trimap[part] = cv2.GC_PR_FGD
    core = inwards > min(shrink, inwards.max() / 2)
    trimap[core if unsure is None else core & ~unsure[window]] = cv2.GC_FGD
    result = np.zeros_like(mask)
    result[window] = tidied(
        graph_cut(np.ascontiguousarray(image[window]), trimap, rounds), part
    )
    return result


def graph_cut(image: np.ndarray, trimap: np.ndarray, rounds: int = 3) -> np.ndarray:
    """Run grabCut from a trimap `[H, W]` of cv2's GC_ values; a side too small for a colour model
    stays as it is.
    """
    foreground = (trimap == cv2.GC_FGD) | (trimap == cv2.GC_PR_FGD)
    if min(foreground.sum(), (~foreground).sum()) < MIN_SAMPLES:
        return foreground
    labels = trimap.copy()
    cv2.setRNGSeed(0)  # its colour models start from k-means
    cv2.grabCut(
        image,
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


class Latest(Generic[Known]):
    """What was computed of the picture that was asked about last: questions follow each other on
    one, which is told by its identity. Nobody changes a picture in place. Threads may ask at once.
    """

    def __init__(self) -> None:
        self._held: tuple[Any, Known] | None = None

    def of(self, picture: Any, compute: Callable[[], Known]) -> Known:
        held = self._held
        if held is None or held[0] is not picture:
            held = self._held = picture, compute()
        return held[1]


def stepped(areas: Sequence[float], best: int, larger: int) -> int:
    """Which of several masks is `larger` steps above the best in order of size; below, if
    negative. Beyond the ends it is the last.
    """
    order = sorted(range(len(areas)), key=lambda index: areas[index])
    return order[min(max(order.index(best) + larger, 0), len(order) - 1)]
