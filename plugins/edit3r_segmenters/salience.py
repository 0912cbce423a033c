"""How much a region looks like an object and like the image's subject, by its cues and by a small
learned network.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import cv2
import numpy as np

from edit3r.kit.compute.outlines import distance_to, overlap
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD
from edit3r_segmenters.superpixels import PALETTE, Superpixels

# shares of the image that an object may cover to be proposed
MIN_AREA, MAX_AREA = 0.008, 0.55
# share that photographers give their subject; a factor of e**1.5 off is one deviation
USUAL_AREA = 0.15
CENTRE_SPREAD = (
    0.22  # deviation of a subject from the middle [image widths and heights]
)
# How surely what stands out is the subject, read off 42 photos (docs/notes/selecting.md)
CLEAR_AREA = 0.22  # share of the image
CLEAR_ASIDE = (0.2, 0.35)  # from the middle [sides]: still, and no longer
HIGHEST_CLEARNESS = 0.8  # of what ends clearly, and may be another thing than is meant
BORDER_SPREAD = 0.12  # share of the image's border an object may touch


@dataclass(frozen=True)
class Objectness:
    """Cues of one region, each in [0, 1]."""

    separation: float  # Bhattacharyya distance of its colours from those around it
    outline: float  # mean edge strength along its outline
    solidity: float  # share of its convex hull that it fills
    centredness: float
    size: float
    inside: float  # 1: does not touch the image's border
    foreground: float  # 1 minus its mean background weight

    @property
    def quality(self) -> float:
        """How good an outline it has, wherever it lies: the proxy for a predicted IoU."""
        return float(np.sqrt(self.separation * self.outline))

    @property
    def as_part(self) -> float:
        """How much it is one thing, wherever it lies and whatever its size: for an object that
        somebody points at.
        """
        return self.separation * np.sqrt(self.outline * self.solidity) * self.inside

    @property
    def salience(self) -> float:
        """How much it looks like the subject of the image."""
        return self.as_part * self.centredness * self.size * (0.25 + self.foreground)


def measure(
    mask: np.ndarray,
    superpixels: Superpixels,
    background: np.ndarray,
    areas: tuple[float, float],
) -> Objectness | None:
    """Measure the cues of a bool mask `[H, W]`, None for one whose share of the image is outside
    `areas`.

    `background` `[H, W]` is the background weight per pixel.
    """
    area = float(mask.mean())
    if not areas[0] <= area <= areas[1] or not mask.any():
        return None
    bits = mask.astype(np.uint8)
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    off_x, off_y = (
        (columns.mean() + 0.5) / width - 0.5,
        (rows.mean() + 0.5) / height - 0.5,
    )
    touched = np.concatenate([bits[0], bits[-1], bits[:, 0], bits[:, -1]]).mean()
    hull = cv2.convexHull(_ends_of_rows(mask))
    return Objectness(
        separation=_separation(mask, superpixels.palette_index),
        outline=_outline(bits, superpixels.edges),
        solidity=min(1.0, len(rows) / max(cv2.contourArea(hull), 1)),
        centredness=float(np.exp(-(off_x**2 + off_y**2) / (2 * CENTRE_SPREAD**2))),
        size=float(np.exp(-((np.log(area / USUAL_AREA) / 1.5) ** 2) / 2)),
        inside=float(np.exp(-((touched / BORDER_SPREAD) ** 2) / 2)),
        foreground=1 - float(background[mask].mean()),
    )


def _ends_of_rows(mask: np.ndarray) -> np.ndarray:
    """x and y of the first and the last pixel of each row of a bool mask: its hull is theirs."""
    rows = np.flatnonzero(mask.any(1))
    first = mask[rows].argmax(1)
    last = mask.shape[1] - 1 - mask[rows, ::-1].argmax(1)
    columns = np.concatenate([first, last])
    return np.stack([columns, np.tile(rows, 2)], 1).astype(np.int32)


def _separation(mask: np.ndarray, palette_index: np.ndarray) -> float:
    """Bhattacharyya distance of the palette colours inside a mask and in a ring around it, both
    maps `[H, W]`.
    """
    reach = 0.35 * np.sqrt(mask.sum())
    ring = (distance_to(mask) <= reach) & ~mask
    inside = np.bincount(palette_index[mask], minlength=PALETTE) / mask.sum()
    outside = np.bincount(palette_index[ring], minlength=PALETTE) / max(1, ring.sum())
    return float(1 - np.sqrt(inside * outside).sum())


def _outline(bits: np.ndarray, edges: np.ndarray) -> float:
    """Mean edge strength on the inner outline of a 0/1 mask, both `[H, W]`, the image's own border
    left out.
    """
    outline = bits > cv2.erode(bits, np.ones((3, 3), np.uint8))
    outline[[0, -1]] = False
    outline[:, [0, -1]] = False
    return float(edges[outline].mean()) if outline.any() else 0.0


def clearness(salience: np.ndarray) -> float:
    """How surely what stands out (`[H, W]` in [0, 1]) is the one subject: the same at a low and a
    high threshold, in one piece, of a subject's size and not aside.
    """
    inside = salience > 0.5
    if not inside.any():
        return 0.0
    bits = inside.astype(np.uint8)
    areas = cv2.connectedComponentsWithStats(bits)[2][1:, cv2.CC_STAT_AREA]
    aside = [
        np.abs((np.nonzero(inside)[axis].mean() + 0.5) / side - 0.5)
        for axis, side in enumerate(inside.shape)
    ]
    clear = overlap(salience > 0.25, salience > 0.75) * areas.max() / areas.sum()
    clear *= np.interp(inside.mean(), (0, CLEAR_AREA), (0.4, 1))
    clear *= np.interp(max(aside), CLEAR_ASIDE, (1, 0.5))
    return float(HIGHEST_CLEARNESS * clear)


_MEAN = np.array(IMAGENET_MEAN, np.float32)
_STD = np.array(IMAGENET_STD, np.float32)


def reader(path: Path) -> Callable[[], cv2.dnn.Net]:
    """Reads the network when it is first asked for; its 0.25 GB are free once this is forgotten."""
    return cache(partial(cv2.dnn.readNetFromONNX, str(path)))


def salience(
    read: Callable[[], cv2.dnn.Net], pixels: np.ndarray, side: int
) -> np.ndarray:
    """How much each pixel of uint8 RGB `[H, W, 3]` belongs to the subject by U²-Netp: float32 `[H,
    W]` in [0, 1].

    A small network (Qin et al. 2020) that OpenCV itself runs; its weights are optional (`edit3r
    weights get u2netp`). Of a crop around a click it tells the thing under the click.

    The network sees the picture squashed to `side` x `side`; it was trained at 320, and half of
    that is a quarter of the time and enough for a crop with one thing in it.
    """
    shrinks = max(pixels.shape[:2]) > side
    square = cv2.resize(
        pixels,
        (side, side),
        interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR,
    )
    scaled = (square.astype(np.float32) / max(1, int(square.max())) - _MEAN) / _STD
    network = read()
    network.setInput(np.ascontiguousarray(scaled.transpose(2, 0, 1)[None]))
    # the first is the fusion of all
    found = network.forward(network.getUnconnectedOutLayersNames()[0])[0, 0]
    return np.clip(cv2.resize(found, pixels.shape[1::-1]), 0, 1)
