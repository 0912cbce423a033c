"""The segmenter `grabcut`: an object cut out by its colours, for machines without a SAM's weights.

GrabCut (Rother et al. 2004, OpenCV's) models the colours of what is marked and of the rest, and
cuts between them. It knows no things: an object of several colours comes in parts.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import (
    SUBJECT,
    Box,
    Click,
    MaskLogits,
    Proposal,
    Segmenter,
)
from edit3r.kit.cache import remembered
from edit3r.kit.compute.outlines import distance_to, soft_edged, window_around
from edit3r.kit.weights.find import at_hand
from edit3r_segmenters import U2NETP
from edit3r_segmenters.masks import (
    SMALLEST_PART,
    graph_cut,
    reduced,
    tidied,
    to_bytes,
)
from edit3r_segmenters.stuff import STUFF, stuff
from edit3r_segmenters.subject import clearness, reader, salience
from edit3r_segmenters.words import plain

# The numbers of this block: no figures kept of each; of the whole file: docs/notes/ledger.md.
# About clicks; the thing lies in their inner half [longer sides].
WINDOWS = (0.15, 0.3, 0.55, 1.0)
SMOOTHING = 0.8  # of the graph segmentation: sigma of its Gaussian [pixels]
SCALES = (100, 300, 800, 2000)  # of the graph segmentation: larger regions
LEAST = 60  # pixels of one of its regions
CORE = 0.4  # share of a box's sides in which an ellipse surely is the thing
AROUND = 0.3  # what is looked at beside what may be the thing [longer sides]
DOT = 0.012  # radius of what a click surely says [longer sides]
MARGIN = 0.05  # of a frame around what may stand out [sides]
LOGIT = 4.0  # of a pixel inside
WHOLE = ("picture", "image", "photo", "scene")  # all of it, where the words say so
UNCLEAR = 0.2  # how surely something stands out where nothing tells


class GrabCutSegmenter(Segmenter):
    """Masks by colour alone; it cannot tell how good they are."""

    class Settings(edit3r.Settings):
        size: int = Field(256, ge=32, le=2048)
        """longer side of the picture in which it cuts [pixels]"""
        learned: bool = True
        """find what stands out by the weights u2netp, where they are at hand"""

    settings: Settings

    def masks(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[Click],
        box: Box | None = None,
        before: Float[Tensor, "h w"] | None = None,
    ) -> MaskLogits:
        """Cuts in windows around the clicks, and regions of like colours at them; from a box, or
        what was there before, cuts alone.
        """
        picture = self._picture(image)
        size = picture.shape[:2]
        if before is not None:
            masks = [_corrected(picture, before, clicks, one) for one in WINDOWS[:3]]
        elif box is not None:
            masks = [_cut(picture, _within(box, size), clicks)]
        else:
            trimaps = [_around(clicks, window, size) for window in WINDOWS]
            masks = [_cut(picture, trimap, clicks) for trimap in trimaps]
            masks += [_regions(picture, clicks, scale) for scale in SCALES]
        return MaskLogits(
            torch.from_numpy(LOGIT * (2 * np.array(masks, np.float32) - 1))
        )

    @remembered
    def words(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """Look up the subject, the sky, the ground and everything; None for any other words."""
        word = plain(text)
        if word == "everything" or (word in WHOLE and _says_all(text)):
            return (Proposal(torch.ones_like(image[0])),)
        if word == SUBJECT:
            return self._subject(image)
        if word not in STUFF:
            return None
        mask, confidence = stuff(word, self._picture(image))
        if not mask.any():
            return ()
        return (Proposal(soft_edged(image, mask), confidence),)

    def _subject(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        """What stands out: as the network sees it, else what is cut out of the middle."""
        picture = self._picture(image)
        weights = at_hand(U2NETP) if self.settings.learned else None
        if weights is None:
            frame = (MARGIN, MARGIN, 1 - 2 * MARGIN, 1 - 2 * MARGIN)
            mask, sure = _cut(picture, _within(frame, picture.shape[:2]), ()), 0.0
        else:
            try:
                seen = salience(reader(weights), to_bytes(picture))
            except (cv2.error, IndexError):
                raise InputError(
                    f"{weights}: is no whole U²-Net as ONNX; fetch it anew with: {U2NETP.get}"
                ) from None
            mask, sure = tidied(seen > 0.5, seen > 0.5), clearness(seen)
        if not mask.any():
            return ()
        found = Proposal(soft_edged(image, mask))
        return (replace(found, confidence=max(UNCLEAR, sure)),)

    def _picture(self, image: Float[Tensor, "3 height width"]) -> np.ndarray:
        """Float32 RGB `[h, w, 3]` at the working size."""
        pixels = image.detach().cpu().float().permute(1, 2, 0).numpy()
        return np.ascontiguousarray(reduced(pixels, self.settings.size))


def _around(
    clicks: Sequence[Click], window: float, size: tuple[int, int]
) -> np.ndarray:
    """Likely the thing near each place on it, surely not far from all of them."""
    away = _distance([place for place, wanted in clicks if wanted], size)
    trimap = np.full(size, cv2.GC_BGD, np.uint8)
    trimap[away <= window / 2] = cv2.GC_PR_BGD
    trimap[away <= window / 4] = cv2.GC_PR_FGD
    return trimap


def _within(box: Box, size: tuple[int, int]) -> np.ndarray:
    """Likely the thing in a box [shares of the sides], surely in its middle and not around it."""
    (height, width), (x, y, across, down) = size, box
    top, left = _pixel((x, y), size)
    bottom, right = _pixel((x + across, y + down), size)
    trimap = np.full(size, cv2.GC_BGD, np.uint8)
    trimap[top : bottom + 1, left : right + 1] = cv2.GC_PR_FGD
    middle = ((x + across / 2) * width, (y + down / 2) * height)
    sides = (max(1.0, CORE * across * width), max(1.0, CORE * down * height))
    return cv2.ellipse(trimap, (middle, sides, 0.0), cv2.GC_FGD, cv2.FILLED)


def _corrected(
    picture: np.ndarray,
    before: Float[Tensor, "h w"],
    clicks: Sequence[Click],
    window: float,
) -> np.ndarray:
    """What was there before, changed around the last click alone."""
    size = picture.shape[:2]
    known = cv2.resize(before.float().numpy(force=True), size[::-1]) > 0
    place, wanted = clicks[-1]
    away = _distance([place], size)
    trimap = np.where(known, cv2.GC_FGD, cv2.GC_BGD).astype(np.uint8)
    likely = np.where(known, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    trimap = np.where(away <= window / 2, likely, trimap)
    trimap[away <= window / 4] = cv2.GC_PR_FGD if wanted else cv2.GC_PR_BGD
    return _cut(picture, trimap, clicks, whole=True)


def _cut(
    picture: np.ndarray,
    trimap: np.ndarray,
    clicks: Sequence[Click],
    whole: bool = False,
) -> np.ndarray:
    """The bool mask `[h, w]` of a cut that obeys the clicks, by the colours of what may be the
    thing and around it; without pieces apart from the clicks unless it stays `whole`.
    """
    radius = max(1, round(DOT * max(trimap.shape)))
    seeds = np.zeros(trimap.shape, np.uint8)
    for place, wanted in clicks:
        row, column = _pixel(place, trimap.shape)
        sure = cv2.GC_FGD if wanted else cv2.GC_BGD
        cv2.circle(trimap, (column, row), radius, sure, cv2.FILLED)
        said = 1 if wanted else 2
        cv2.circle(seeds, (column, row), radius, said, cv2.FILLED)
    inside = np.zeros(trimap.shape, dtype=bool)
    if (trimap != cv2.GC_BGD).any():
        window = window_around(trimap != cv2.GC_BGD, AROUND * max(trimap.shape))
        inside[window] = graph_cut(
            np.ascontiguousarray(picture[window]), trimap[window]
        )
    on, beside = seeds == 1, seeds == 2
    whole |= not on.any()
    kept = tidied(inside, inside if whole else on, SMALLEST_PART if whole else 0)
    return kept & ~beside  # a dot is no hole to fill


def _regions(picture: np.ndarray, clicks: Sequence[Click], scale: int) -> np.ndarray:
    """The regions at places on the thing, of a graph segmentation (Felzenszwalb and Huttenlocher
    2004): bool `[h, w]`.
    """
    lab = cv2.cvtColor(to_bytes(picture), cv2.COLOR_RGB2LAB)
    cut = cv2.ximgproc.segmentation.createGraphSegmentation(SMOOTHING, scale, LEAST)
    labels = cut.processImage(lab)
    seeds = np.zeros(labels.shape, dtype=bool)
    for place, wanted in clicks:
        seeds[_pixel(place, labels.shape)] |= wanted
    return tidied(np.isin(labels, labels[seeds]), seeds, smallest=0)


def _distance(
    places: Sequence[tuple[float, float]], size: tuple[int, int]
) -> np.ndarray:
    """How far each pixel is from the nearest place [longer sides]."""
    there = np.zeros(size, dtype=bool)
    for place in places:
        there[_pixel(place, size)] = True
    return distance_to(there) / max(size)


def _pixel(place: tuple[float, float], size: Sequence[int]) -> tuple[int, int]:
    """Row and column of a place x, y in [0, 1]."""
    (x, y), (height, width) = place, size
    return min(int(y * height), height - 1), min(int(x * width), width - 1)


def _says_all(text: str) -> bool:
    """Whether a photo and not a thing on it is meant: "the picture" may hang on a wall."""
    words = text.lower().split()
    return "picture" not in words or bool({"whole", "entire", "all"} & {*words})
