"""Sky and ground, which need no learning: where they lie, and how surely it is them."""

import cv2
import numpy as np

from edit3r.kit.compute.sky import sky_mask
from edit3r_segmenters.masks import graph_cut, tidied

# The numbers of this block: those of the sky as said there, the ground's by eye.
STUFF = ("sky", "ground", "floor", "road", "street", "pavement")
# rows above which there is no ground and below which it is likely, in heights
HIGHEST_GROUND, SURE_GROUND = 0.3, 0.93
# How surely it is the sky, read off 53 photos of fifteen places (docs/notes/selecting.md)
BLUE = 10.0  # b that is surely no wall's, towards blue [CIE Lab units]
WARM = 3.0  # b of a wall [CIE Lab units]
BRIGHTER = (25.0, 45.0)  # than all else: as a wall may be, and as only a sky is [L]
SPANS = 0.7  # share of the photo's upper edge that a sky reaches along
HIGHEST_CONFIDENCE = 0.9  # what looks like a sky may be none
GROUND_CONFIDENCE = 0.35  # what joins the lower edge is often a table or a wall


def stuff(word: str, image: np.ndarray) -> tuple[np.ndarray, float]:
    """One of `STUFF` on float RGB `[H, W, 3]` in [0, 1]: a bool mask, empty where it is not there,
    and how surely it is that.
    """
    if word != "sky":
        return ground(image), GROUND_CONFIDENCE
    mask = sky_mask(image)
    return mask, sky_confidence(image, mask)


def sky_confidence(image: np.ndarray, mask: np.ndarray) -> float:
    """How surely a bool mask is sky and no wall: blue, or much brighter than all else and not warm,
    along the upper edge.
    """
    if not mask.any() or mask.all():
        return 0.0
    lab = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2LAB)
    lightness, _, b = lab[mask].mean(0)
    brighter = np.interp(lightness - lab[~mask][:, 0].mean(), BRIGHTER, (0, 1))
    cool = np.interp(b, (0, WARM), (1, 0))
    looks = max(np.interp(-b, (0, BLUE), (0, 1)), brighter * cool)
    return float(HIGHEST_CONFIDENCE * looks * min(1.0, mask[0].mean() / SPANS))


def ground(image: np.ndarray) -> np.ndarray:
    """The ground on float RGB `[H, W, 3]` as a bool mask: what looks like the picture's lower edge
    and joins it.
    """
    height, width = image.shape[:2]
    trimap = np.full((height, width), cv2.GC_PR_BGD, np.uint8)
    trimap[: int(HIGHEST_GROUND * height)] = cv2.GC_BGD
    trimap[int(SURE_GROUND * height) :] = cv2.GC_PR_FGD
    lowest = np.zeros((height, width), dtype=bool)
    lowest[-2:] = True
    return tidied(graph_cut(image, trimap, rounds=5), lowest)
