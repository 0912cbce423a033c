"""Sky, ground and plain walls, which need no learning: where they lie, what they look like, and how
surely it is them.
"""

import cv2
import numpy as np

from edit3r_segmenters.masks import graph_cut, tidied
from edit3r_segmenters.superpixels import Superpixels

STUFF = ("sky", "ground", "floor", "wall", "walls")
SKY_CHROMA = 14.0  # of a grey or white sky, at most [CIE Lab units]
SKY_LIGHT = 45.0  # least lightness of a sky
SMOOTH = 0.22  # most edge strength of a sky
SAME_SKY = (
    14.0  # colour distance to a piece of sky at the top within which more of it may lie
)
HIGHEST_GROUND, SURE_GROUND = (
    0.3,
    0.93,
)  # rows above which there is no ground and below which it is likely, in heights
# How surely it is the sky, read off 53 photos of fifteen places (docs/notes/selecting.md)
BLUE = 10.0  # b that is surely no wall's, towards blue [CIE Lab units]
WARM = 3.0  # b of a wall [CIE Lab units]
BRIGHTER = (25.0, 45.0)  # than all else: as a wall may be, and as only a sky is [L]
SPANS = 0.7  # share of the photo's upper edge that a sky reaches along
HIGHEST_SURETY = 0.9  # what looks like a sky may be none
GROUND_SURETY = 0.35  # what joins the lower edge is often a table or a wall
SAME_WALL = 12.0  # colour distance within which a wall is one, lightness counting half
LEAST_WALL = 0.12  # share of the photo below which what is plain is a cupboard's or a book's side
LOWEST_WALL = 0.55  # mean row of a wall at most: below lie tables and streets [heights]
WALL_SURETY = 0.35  # a white wardrobe is as plain as the wall behind it


def stuff(
    word: str, pixels: np.ndarray, cells: Superpixels
) -> tuple[np.ndarray, float]:
    """One of `STUFF` on uint8 RGB `[H, W, 3]`: a bool mask, empty where it is not there, and how
    surely it is that.
    """
    if word in ("wall", "walls"):
        mask = wall(pixels, cells)
        return mask, WALL_SURETY * mask.any()
    if word != "sky":
        return ground(pixels), GROUND_SURETY
    mask = sky(pixels, cells)
    if mask is None:
        return np.zeros(pixels.shape[:2], dtype=bool), 0.0
    return mask, sky_surety(pixels, mask)


def sky_surety(pixels: np.ndarray, mask: np.ndarray) -> float:
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
    return float(HIGHEST_SURETY * looks * min(1.0, mask[0].mean() / SPANS))


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
    trimap = np.where(alike & (distance < SAME_SKY), cv2.GC_PR_FGD, cv2.GC_BGD)[
        cells.labels
    ].astype(np.uint8)
    trimap[(edges < 2 * SMOOTH)[cells.labels] & (trimap == cv2.GC_BGD)] = cv2.GC_PR_BGD
    trimap[seeds[cells.labels]] = cv2.GC_FGD
    return tidied(graph_cut(pixels, trimap), seeds[cells.labels])


def wall(pixels: np.ndarray, cells: Superpixels) -> np.ndarray:
    """The plain wall on uint8 RGB `[H, W, 3]` as a bool mask: the commonest colour of what is
    smooth, where it reaches the border's upper half; empty where that is too little, or a sky.
    """
    height = len(pixels)
    colours = cells.colours * (0.5, 1, 1)
    edges = np.bincount(cells.labels.ravel(), cells.edges.ravel()) / cells.areas
    smooth = edges < SMOOTH
    sides = cells.labels[: height // 2, [0, -1]]
    reached = np.unique(np.concatenate((cells.labels[0], sides.ravel())))
    border = smooth & np.isin(np.arange(len(colours)), reached)
    nothing = np.zeros(pixels.shape[:2], dtype=bool)
    if not border.any():
        return nothing
    apart = np.linalg.norm(colours[:, None] - colours[None, border], axis=2)
    alike = (apart < SAME_WALL) & smooth[:, None]
    common = int((alike * cells.areas[:, None]).sum(0).argmax())
    trimap = np.where(alike[:, common], cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    trimap[apart[:, common] > 1.5 * SAME_WALL] = cv2.GC_BGD
    seeds = alike[:, common] & border
    trimap[seeds] = cv2.GC_FGD
    cut = graph_cut(pixels, trimap[cells.labels].astype(np.uint8))
    mask = tidied(cut, seeds[cells.labels])
    too_little = mask.mean() < LEAST_WALL
    if too_little or np.nonzero(mask)[0].mean() > LOWEST_WALL * height:
        return nothing
    return nothing if sky_surety(pixels, mask) > 0.5 else mask


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
