"""Patterns for what nobody saw: copies of what surrounds a hole, where they suit its colours."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

Picture = Float[np.ndarray, "height width 3"]
Where = Bool[np.ndarray, "height width"]

# By twelve cut holes, and tried on twelve others: docs/notes/recoloring.md.
AROUND = 0.5  # how far from a piece patterns are copied from [its longer sides]
COARSE = 0.04  # over which colours are compared [longer sides of a piece]
UNLIKE = 15.0  # from the smooth surface, above which a copy fades into it [CIE Lab]
FOREIGN = 20.0  # from all of that surface, above which nothing is copied [CIE Lab]
LEAST = (
    0.25  # share of the surroundings that is left to copy from; else all of them serve
)
COLOURS = 400  # of the smooth surface that are compared with, at most
SPECK = 8  # shorter side under which a piece stays smooth [pixels]
LARGEST = 96  # longer side at which a piece is filled, at most [pixels]


def with_patterns(picture: Picture, hole: Where) -> Picture:
    """The picture in [0, 1], whose hole is filled smoothly, with patterns in each piece of it."""
    picture = np.array(picture, np.float32)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(hole.astype(np.uint8))
    for label in range(1, count):
        left, top, width, height, _ = boxes[label]
        if min(width, height) < SPECK:
            continue
        side = max(width, height)
        margin = round(AROUND * side)
        rows = slice(max(0, top - margin), top + height + margin)
        columns = slice(max(0, left - margin), left + width + margin)
        around, piece = picture[rows, columns], labels[rows, columns] == label
        scale = min(1.0, LARGEST / side)
        size = [round(scale * length) for length in piece.shape[::-1]]
        small = cv2.resize(around, size, interpolation=cv2.INTER_AREA)
        bits = hole[rows, columns].astype(np.uint8)
        unknown = cv2.resize(bits, size, interpolation=cv2.INTER_NEAREST) > 0
        filled = _copied(small, unknown, COARSE * scale * side)
        large = cv2.resize(filled, piece.shape[::-1], interpolation=cv2.INTER_CUBIC)
        around[piece] = large.clip(0, 1)[piece]  # cubic goes beyond
    return picture


def _copied(smooth: Picture, hole: Where, blur: float) -> Picture:
    """The picture with a hole filled by OpenCV's shift map (He and Sun, "Statistics of Patch
    Offsets for Image Completion", 2012).

    A thing that stands beside the hole is not copied into it: its colours are not among those of
    the smooth surface. Where a copy differs from that surface, it fades into it.
    """
    surface = cv2.cvtColor(smooth, cv2.COLOR_RGB2Lab)
    coarse, inside = _blurred(surface, blur), surface[hole]
    inside = inside[:: max(1, len(inside) // COLOURS)]
    apart = [np.linalg.norm(row[:, None] - inside, axis=-1).min(1) for row in coarse]
    usable = ~hole & (np.stack(apart) < FOREIGN)
    if usable.sum() < LEAST * (~hole).sum():
        usable = ~hole
    pixels = cv2.cvtColor((255 * smooth).round().astype(np.uint8), cv2.COLOR_RGB2Lab)
    filled = np.zeros_like(pixels)
    known = usable.astype(np.uint8) * 255
    cv2.xphoto.inpaint(pixels, known, filled, cv2.xphoto.INPAINT_SHIFTMAP)
    found = hole & filled.any(-1)  # it leaves out what has no counterpart
    copied = cv2.cvtColor(filled, cv2.COLOR_Lab2RGB).astype(np.float32) / 255
    copied = np.where(found[..., None], copied, smooth)
    copies = _blurred(cv2.cvtColor(copied, cv2.COLOR_RGB2Lab), blur)
    unlike = np.linalg.norm(copies - coarse, axis=-1)
    share = _blurred((2 - unlike / UNLIKE).clip(0, 1), blur)[..., None]
    return share * copied + (1 - share) * smooth


def _blurred(values: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(values.astype(np.float32), (0, 0), max(sigma, 0.1))
