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
from edit3r.kit.compute.outlines import soft_edged
from edit3r.kit.weights.find import at_hand
from edit3r_segmenters import U2NETP
from edit3r_segmenters.masks import graph_cut, reduced, tidied, to_bytes
from edit3r_segmenters.stuff import STUFF, stuff
from edit3r_segmenters.subject import clearness, reader, salience
from edit3r_segmenters.words import plain

REACHES = (0.08, 0.16, 0.3)  # of things around a click [longer sides]
BEYOND = 2.0  # reaches, from which a click's thing surely ends
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
        """Cuts from three reaches around the clicks; from a box, or what was there before, one."""
        picture = self._picture(image)
        if before is not None:
            trimaps = [_around_mask(before, picture.shape[:2])]
        elif box is not None:
            trimaps = [_within(box, picture.shape[:2])]
        else:
            trimaps = [
                _around_clicks(clicks, reach, picture.shape[:2]) for reach in REACHES
            ]
        return _logits([_cut(picture, trimap, clicks) for trimap in trimaps])

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


def _around_clicks(
    clicks: Sequence[Click], reach: float, size: tuple[int, int]
) -> np.ndarray:
    """Likely the thing near each place on it, surely not far from all of them."""
    longer = max(size)
    near = np.full(size, np.inf, np.float32)
    rows, columns = np.mgrid[: size[0], : size[1]]
    for place, wanted in clicks:
        if wanted:
            row, column = _pixel(place, size)
            near = np.minimum(near, np.hypot(rows - row, columns - column) / longer)
    trimap = np.full(size, cv2.GC_BGD, np.uint8)
    trimap[near < BEYOND * reach] = cv2.GC_PR_BGD
    trimap[near < reach] = cv2.GC_PR_FGD
    return trimap


def _within(box: Box, size: tuple[int, int]) -> np.ndarray:
    """Likely the thing in a box [shares of the sides], surely not around it."""
    (top, left), (bottom, right) = (
        (round(y * size[0]), round(x * size[1]))
        for x, y in ((box[0], box[1]), (box[0] + box[2], box[1] + box[3]))
    )
    trimap = np.full(size, cv2.GC_BGD, np.uint8)
    trimap[top : max(bottom, top + 1), left : max(right, left + 1)] = cv2.GC_PR_FGD
    return trimap


def _around_mask(before: Float[Tensor, "h w"], size: tuple[int, int]) -> np.ndarray:
    """Likely the thing where it was before."""
    logits = cv2.resize(before.float().numpy(force=True), size[::-1])
    return np.where(logits > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)


def _cut(
    picture: np.ndarray, trimap: np.ndarray, clicks: Sequence[Click]
) -> np.ndarray:
    """The bool mask `[h, w]` of a cut that obeys the clicks, without pieces apart from them."""
    radius = max(1, round(DOT * max(trimap.shape)))
    seeds = np.zeros(trimap.shape, np.uint8)
    for place, wanted in clicks:
        row, column = _pixel(place, trimap.shape)
        sure = cv2.GC_FGD if wanted else cv2.GC_BGD
        cv2.circle(trimap, (column, row), radius, sure, cv2.FILLED)
        if wanted:
            cv2.circle(seeds, (column, row), radius, 1, cv2.FILLED)
    inside = graph_cut(picture, trimap)
    return tidied(inside, seeds > 0 if seeds.any() else inside)


def _logits(masks: Sequence[np.ndarray]) -> MaskLogits:
    return MaskLogits(torch.from_numpy(LOGIT * (2 * np.float32(masks) - 1)))


def _pixel(place: tuple[float, float], size: Sequence[int]) -> tuple[int, int]:
    """Row and column of a place x, y in [0, 1]."""
    (x, y), (height, width) = place, size
    return min(int(y * height), height - 1), min(int(x * width), width - 1)


def _says_all(text: str) -> bool:
    """Whether a photo and not a thing on it is meant: "the picture" may hang on a wall."""
    words = text.lower().split()
    return "picture" not in words or bool({"whole", "entire", "all"} & {*words})
