"""Answers marks on one photo by the sum, where a segmenter has several masks for them."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Marks, Proposal, as_proposal
from edit3r.kit.compute.outlines import soft_edged
from edit3r.kit.segmenting import HeldSegmenter
from edit3r_select.asking import selected
from edit3r_select.cues import Appearance, Asked, Click
from edit3r_select.sum import SURE, Chosen, MaskCandidate

LONGER = 512  # longer side of a photo whose masks are compared: weights are for this [pixels]

Image = Float[Tensor, "3 height width"]


class SummingSegmenter(HeldSegmenter):
    """Chooses among all masks that a segmenter's `ask` has for marks; a segmenter without reads
    them itself.
    """

    def segment_marks(self, image: Image, marks: Marks) -> Proposal:
        chosen = self._chosen(image, marks)
        if chosen is None:
            return super().segment_marks(image, marks)
        return _as_proposal(image, chosen.stepped(marks.larger), chosen.confidence)

    def readings(self, image: Image, marks: Marks) -> tuple[Proposal, ...]:
        """All that the marks may mean; the first is as sure as the sum is, the others share the
        rest by theirs.
        """
        chosen = self._chosen(image, marks)
        if chosen is None:
            return super().readings(image, marks)
        pairs = zip(chosen.candidates, _shares(chosen))
        return tuple(_as_proposal(image, one, share) for one, share in pairs)

    def _chosen(self, image: Image, marks: Marks) -> Chosen | None:
        """What the marks may mean by the sum, one click after the other; None where the segmenter
        has one answer only, and without marks.

        A click that says what is known waits until an answer to another one disobeys it: nobody
        told in which order clicks on the thing and beside it were made.
        """
        photo, ask = Appearance(_rgb(image)), partial(self.ask, image)
        chosen, before = None, None
        if marks.prior is not None:
            before = _as_logits(marks.prior, photo.size)
            chosen = Chosen((MaskCandidate(before, 0.0, 1.0),), 1.0)
        elif marks.stroke or marks.box:
            drawn = Asked(stroke=marks.stroke, box=marks.box)
            chosen = selected(photo, drawn, ask)
            before = None if chosen is None else chosen.best.logits
        waiting = _clicks(marks)
        clicks: tuple[Click, ...] = ()
        while new := [one for one in waiting if not _obeyed(before, photo, one)]:
            waiting.remove(new[0])
            clicks = (*clicks, new[0])
            was = None if before is None else before > 0
            asked = Asked(clicks, marks.stroke, marks.box, was)
            chosen = selected(photo, asked, ask, before)
            if chosen is None:
                return None
            before = chosen.best.logits
        return chosen if _clicks(marks) or marks.stroke or marks.box else None


def _clicks(marks: Marks) -> list[Click]:
    """All clicks, those on the thing first."""
    said = [(place, True) for place in marks.positive]
    return said + [(place, False) for place in marks.negative]


def _obeyed(before: np.ndarray | None, photo: Appearance, click: Click) -> bool:
    place, wanted = click
    return before is not None and (before[photo.pixel(place)] > 0) == wanted


def _shares(chosen: Chosen) -> Iterator[float]:
    """How likely each candidate is what is meant; they add up to 1."""
    yield chosen.confidence
    scores = np.array([one.score for one in chosen.candidates[1:]])
    if len(scores):
        parts = np.exp(scores - scores.max())
        yield from ((1 - chosen.confidence) * parts / parts.sum()).tolist()


def _rgb(image: Image) -> np.ndarray:
    """uint8 RGB `[h, w, 3]`, reduced to `LONGER`."""
    rgb = image.detach().cpu().float().clamp(0, 1).permute(1, 2, 0).numpy() * 255
    pixels = np.ascontiguousarray(rgb.round().astype(np.uint8))
    height, width = pixels.shape[:2]
    scale = LONGER / max(height, width)
    if scale >= 1:
        return pixels
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)


def _as_logits(
    mask: Float[Tensor, "height width"], size: tuple[int, int]
) -> np.ndarray:
    values = cv2.resize(mask.float().numpy(force=True), size[::-1])
    return np.where(values > 0.5, SURE, -SURE).astype(np.float32)


def _as_proposal(image: Image, one: MaskCandidate, confidence: float) -> Proposal:
    """A candidate at the photo's size, its soft edge following the photo's own."""
    inside = cv2.resize(one.logits, tuple(image.shape[:0:-1])) > 0
    found = as_proposal(soft_edged(image, inside))
    stability = (one.logits > 1).sum() / max(1, (one.logits > -1).sum())
    return replace(
        found,
        stability=float(stability),
        predicted_iou=min(max(one.quality, 0.0), 1.0),
        confidence=confidence,
    )
