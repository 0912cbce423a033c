"""Sky, found by its looks: smooth, blue or nearly white, and coming down from the top of a photo.

Nothing lies behind a sky, so it tells how near what stands before it must be.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

# The numbers of this block, chosen on one castle: docs/notes/ledger.md.
# Share of all photos that must look like sky before any of it counts: ceilings and lamps do too.
MIN_SHARE = 0.08
MIN_TOP = 0.2  # share of a photo's top row that must be sky
MIN_SEED = 0.003  # area of a piece of sky at the top [images]
MIN_SURE = 0.6  # share of a piece that must be clearly blue, or white as only light is
GROUND = 0.05  # height above the lower edge that no sky reaches [images]
# All colours in CIE Lab
MAX_SLOPE = 2.0  # of a smooth colour [units a pixel]
SAME = 9.0  # distance of colours around a piece of sky that belong to it
REACH = 0.03  # how far around, in each of the rounds [long sides]
ROUNDS = 4
MAX_CLOUD = 0.05  # area of what is brighter than the sky and within it [images]


def find_skies(
    images: Sequence[Float[np.ndarray, "height width 3"]],
) -> list[Bool[np.ndarray, "height width"]] | None:
    """The sky on images (colours in [0, 1]) of one scene; None: too little to be sure."""
    skies = [sky_mask(image) for image in images]
    sure = [sky.mean() * (sky[0].mean() > MIN_TOP) for sky in skies]
    return skies if np.mean(sure) >= MIN_SHARE else None


def sky_mask(
    image: Float[np.ndarray, "height width 3"],
) -> Bool[np.ndarray, "height width"]:
    """What looks like sky and comes down from the top of the image."""
    lab = _lab(image)
    lightness, _, b = cv2.split(lab)
    alike = coloured_like_sky(image)
    blurred = cv2.GaussianBlur(lab, (0, 0), 1.0)
    slopes = [
        cv2.Sobel(blurred, cv2.CV_32F, *axis, scale=1 / 8) for axis in ((1, 0), (0, 1))
    ]
    smooth = alike & (np.square(slopes).sum((0, 3)) < MAX_SLOPE**2)
    _, pieces = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    count = pieces.max() + 1
    area = np.bincount(pieces.ravel(), minlength=count)
    sure = np.bincount(pieces[(b < -8) | (lightness > 95)], minlength=count)
    possible = sure >= MIN_SURE * area
    possible[pieces[-1 - int(GROUND * len(image)) :]] = False
    possible[0] = False
    at_top = np.isin(np.arange(count), pieces[0]) & (area > MIN_SEED * pieces.size)
    sky = (possible & at_top)[pieces]
    if not sky.any():
        return sky
    radius = max(2, round(REACH * max(pieces.shape)))
    for _ in range(ROUNDS):
        near, local = _means(lab, sky, radius)
        same = near & alike & (np.linalg.norm(lab - local, axis=2) < SAME)
        # A piece that mostly continues what is beside it belongs to it as a whole.
        beside = np.bincount(pieces[near], minlength=count)
        continues = np.bincount(pieces[same], minlength=count) > beside / 2
        sky |= same | (possible & continues)[pieces]
    return sky | _clouds(sky, lightness)


def coloured_like_sky(
    image: Float[np.ndarray, "height width 3"],
) -> Bool[np.ndarray, "height width"]:
    """Pixels whose colour a sky could have, on an image of colours in [0, 1]."""
    lightness, a, b = cv2.split(_lab(image))
    blue = (b < -4) & (b < -0.7 * np.abs(a)) & (lightness > 35)
    white = (np.hypot(a, b) < 10) & (lightness > 72)
    return blue | white | ((lightness > 90) & (b < 0) & (a < 0))


def _lab(
    image: Float[np.ndarray, "height width 3"],
) -> Float[np.ndarray, "height width 3"]:
    return cv2.cvtColor(np.ascontiguousarray(image, np.float32), cv2.COLOR_RGB2LAB)


def _means(
    colours: Float[np.ndarray, "height width 3"],
    mask: Bool[np.ndarray, "height width"],
    radius: int,
) -> tuple[Bool[np.ndarray, "height width"], Float[np.ndarray, "height width 3"]]:
    """Which pixels have some of the mask around them, and its mean colour there."""
    window = (2 * radius + 1, 2 * radius + 1)
    weight = cv2.blur(mask.astype(np.float32), window)
    mean = cv2.blur(colours * mask[..., None], window)
    return weight > 0.02, mean / np.maximum(weight, 1e-6)[..., None]


def _clouds(
    sky: Bool[np.ndarray, "height width"], lightness: Float[np.ndarray, "height width"]
) -> Bool[np.ndarray, "height width"]:
    """Bright pieces within the sky: branches, poles and birds are dark."""
    _, holes, boxes, _ = cv2.connectedComponentsWithStats(
        (~sky).astype(np.uint8), connectivity=4
    )
    area = boxes[:, cv2.CC_STAT_AREA]
    mean = np.bincount(holes.ravel(), lightness.ravel()) / area
    cloud = (area < MAX_CLOUD * sky.size) & (mean > np.median(lightness[sky]) - 5)
    cloud[holes[-1]] = False
    cloud[0] = False
    return cloud[holes]
