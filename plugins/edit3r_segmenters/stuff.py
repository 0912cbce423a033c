"""Sky and ground, which need no learning: where they lie, what they look like, and how surely it is
them.
"""

import cv2
import numpy as np

from edit3r_segmenters.masks import graph_cut, tidied
from edit3r_segmenters.superpixels import Superpixels

STUFF = ("sky", "ground", "floor", "road", "street", "pavement")
SKY_CHROMA = 14.0  # of a grey or white sky, at most [CIE Lab units]
SKY_LIGHT = 45.0  # least lightness of a sky
SMOOTH = 0.22  # most edge strength of a sky
SAME_SKY = (
    14.0  # colour distance to a piece of sky at the top within which more of it may lie
)
HAZE_STEP = 6.0  # colour distance between neighbours, over which sky passes into haze
# rows above which there is no ground and below which it is likely, in heights
HIGHEST_GROUND, SURE_GROUND = 0.3, 0.93
# How surely it is the sky, read off 53 photos of fifteen places (docs/notes/selecting.md)
BLUE = 10.0  # b that is surely no wall's, towards blue [CIE Lab units]
WARM = 3.0  # b of a wall [CIE Lab units]
BRIGHTER = (25.0, 45.0)  # than all else: as a wall may be, and as only a sky is [L]
SPANS = 0.7  # share of the photo's upper edge that a sky reaches along
HIGHEST_CONFIDENCE = 0.9  # what looks like a sky may be none
GROUND_CONFIDENCE = 0.35  # what joins the lower edge is often a table or a wall


def stuff(
    word: str, pixels: np.ndarray, cells: Superpixels
) -> tuple[np.ndarray, float]:
    """One of `STUFF` on uint8 RGB `[H, W, 3]`: a bool mask, empty where it is not there, and how
    surely it is that.
    """
    if word != "sky":
        return ground(pixels), GROUND_CONFIDENCE
    mask = sky(pixels, cells)
    if mask is None:
        return np.zeros(pixels.shape[:2], dtype=bool), 0.0
    return mask, sky_confidence(pixels, mask)


def sky_confidence(pixels: np.ndarray, mask: np.ndarray) -> float:
    """How surely a bool mask is sky and no wall: blue, or much brighter than all else and not warm,
    along the upper edge.
    """
    if not mask.any() or mask.all():
        return 0.0
    lab = cv2.cvtColor(pixels.astype(np.float32) / 255, cv2.COLOR_RGB2LAB)
    lightness, _, b = lab[mask].mean(0)
    brighter = np.interp(lightness - lab[~mask][:, 0].mean(), BRIGHTER, (0, 1))
    cool = np.interp(b, (0, WARM), (1, 0))
    looks = max(np.interp(-b, (0, BLUE), (0, 1)), brighter * cool)
    return float(HIGHEST_CONFIDENCE * looks * min(1.0, mask[0].mean() / SPANS))


def sky(pixels: np.ndarray, cells: Superpixels) -> np.ndarray | None:
    """The sky on uint8 RGB `[H, W, 3]` as a bool mask; None where nothing smooth and bright touches
    the top.
    """
    lightness, a, b = cells.colours.T
    edges = np.bincount(cells.labels.ravel(), cells.edges.ravel()) / cells.areas
    alike = (
        (lightness > SKY_LIGHT)
        & ((np.hypot(a, b) < SKY_CHROMA) | (b < -5))
        & (edges < SMOOTH)
    )
    top = np.zeros(len(cells.areas), dtype=bool)
    top[np.unique(cells.labels[0])] = True
    seeds = alike & top
    if not seeds.any():
        return None
    distance = np.linalg.norm(
        cells.colours[:, None] - cells.colours[None, seeds], axis=2
    ).min(1)
    likely = _with_haze(alike & (distance < SAME_SKY), alike, cells)
    trimap = np.where(likely, cv2.GC_PR_FGD, cv2.GC_BGD)[cells.labels].astype(np.uint8)
    trimap[(edges < 2 * SMOOTH)[cells.labels] & (trimap == cv2.GC_BGD)] = cv2.GC_PR_BGD
    trimap[seeds[cells.labels]] = cv2.GC_FGD
    return tidied(graph_cut(pixels, trimap), seeds[cells.labels])


def _with_haze(likely: np.ndarray, alike: np.ndarray, cells: Superpixels) -> np.ndarray:
    """The superpixels that may be sky, with those into which it passes without an edge."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    one, other = cells.pairs.T
    step = np.linalg.norm(cells.colours[one] - cells.colours[other], axis=1)
    smooth = (step < HAZE_STEP) & (cells.strengths < SMOOTH)
    joined = smooth & alike[one] & alike[other]
    links = coo_matrix(
        (joined[joined], (one[joined], other[joined])), (len(alike), len(alike))
    )
    _, piece = connected_components(links, directed=False)
    return alike & np.isin(piece, piece[likely])


def ground(pixels: np.ndarray) -> np.ndarray:
    """The ground on uint8 RGB `[H, W, 3]` as a bool mask: what looks like the picture's lower edge
    and joins it.
    """
    height, width = pixels.shape[:2]
    trimap = np.full((height, width), cv2.GC_PR_BGD, np.uint8)
    trimap[: int(HIGHEST_GROUND * height)] = cv2.GC_BGD
    trimap[int(SURE_GROUND * height) :] = cv2.GC_PR_FGD
    lowest = np.zeros((height, width), dtype=bool)
    lowest[-2:] = True
    return tidied(graph_cut(pixels, trimap, rounds=5), lowest)
