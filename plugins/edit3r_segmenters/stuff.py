"""Words for stuff that needs no learning: the sky and the ground, by where they lie and what they look like."""

import cv2
import numpy as np

from edit3r_segmenters.masks import graph_cut, tidied
from edit3r_segmenters.superpixels import Superpixels

SKY_CHROMA = 14.0  # of a grey or white sky, at most [CIE Lab units]
SKY_LIGHT = 45.0  # least lightness of a sky
SMOOTH = 0.22  # most edge strength of a sky
SAME_SKY = 14.0  # colour distance to a piece of sky at the top within which more of it may lie
HIGHEST_GROUND, SURE_GROUND = 0.3, 0.93  # rows above which there is no ground and below which it is likely, in heights


def plain(text: str) -> str:
    """A name without case, article and other filler: 'the whole picture' is 'picture'."""
    return " ".join(word for word in text.lower().split() if word not in ("the", "a", "an", "whole", "entire", "all"))


def sky(pixels: np.ndarray, cells: Superpixels) -> np.ndarray | None:
    """The sky on uint8 RGB `[H, W, 3]` as a bool mask; None where nothing smooth and bright touches the top."""
    lightness, a, b = cells.colours.T
    edges = np.bincount(cells.labels.ravel(), cells.edges.ravel()) / cells.areas
    alike = (lightness > SKY_LIGHT) & ((np.hypot(a, b) < SKY_CHROMA) | (b < -5)) & (edges < SMOOTH)
    top = np.zeros(len(cells.areas), dtype=bool)
    top[np.unique(cells.labels[0])] = True
    seeds = alike & top
    if not seeds.any():
        return None
    distance = np.linalg.norm(cells.colours[:, None] - cells.colours[None, seeds], axis=2).min(1)
    trimap = np.where(alike & (distance < SAME_SKY), cv2.GC_PR_FGD, cv2.GC_BGD)[cells.labels].astype(np.uint8)
    trimap[(edges < 2 * SMOOTH)[cells.labels] & (trimap == cv2.GC_BGD)] = cv2.GC_PR_BGD
    trimap[seeds[cells.labels]] = cv2.GC_FGD
    return tidied(graph_cut(pixels, trimap), seeds[cells.labels])


def ground(pixels: np.ndarray) -> np.ndarray:
    """The ground on uint8 RGB `[H, W, 3]` as a bool mask: what looks like the picture's lower edge and joins it."""
    height, width = pixels.shape[:2]
    trimap = np.full((height, width), cv2.GC_PR_BGD, np.uint8)
    trimap[: int(HIGHEST_GROUND * height)] = cv2.GC_BGD
    trimap[int(SURE_GROUND * height) :] = cv2.GC_PR_FGD
    lowest = np.zeros((height, width), dtype=bool)
    lowest[-2:] = True
    return tidied(graph_cut(pixels, trimap, rounds=5), lowest)
