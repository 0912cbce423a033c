"""Segmentation without learned weights: an offline stand-in with SAM2's outputs.

An image is cut into superpixels, merged region by region into a tree; every region of the tree is a
candidate and is judged by its outline, its difference from what surrounds it, and its place in the
image. It knows colours and edges, not things: an object of several colours comes in parts, and
words mean nothing to it.
"""

import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Marks, Proposal, Segmenter, Tracks, as_proposal
from edit3r.contract.reporting import warn
from edit3r.kit.cache import remembered
from edit3r.kit.compute.outlines import overlap, softened
from edit3r.kit.weights.find import at_hand
from edit3r_segmenters import U2NETP, tracking
from edit3r_segmenters.candidates import (
    Box,
    Candidate,
    Click,
    Evidence,
    Salience,
    by_size,
    choose,
)
from edit3r_segmenters.masks import (
    Latest,
    reduced,
    snapped,
    tidied,
    to_bytes,
)
from edit3r_segmenters.salience import (
    MAX_AREA,
    MIN_AREA,
    Objectness,
    clearness,
    measure,
    reader,
    salience,
)
from edit3r_segmenters.stuff import STUFF, stuff
from edit3r_segmenters.superpixels import (
    Superpixels,
    background_weights,
    merge_tree,
    superpixels,
)
from edit3r_segmenters.words import plain

MAX_OBJECTS = 24  # that are proposed
REFINED = 4  # of the most salient, whose outline is refined
SAME_OBJECT = 0.6  # intersection over union above which two candidates are one object
# how far an outline may move in and out when it is refined [square roots of the area]
SNAP = (0.06, 0.25)
SNAP_FINE = (0.04, 0.04)  # the same for the second time, on the larger image
# sides of the crops around a click [longer sides of the picture]
CROPS = (0.5, 0.35, 0.25, 0.16)
# what the learned network sees of a picture and of a crop [pixels]
WHOLE_SIDE, CROP_SIDE = 320, 160
WHOLE = ("picture", "image", "photo", "scene")  # all of it, where the words say so
# How surely all but what stands out is the background where that is not clear
UNCLEAR_CONFIDENCE = 0.2
MAX_READINGS = 3  # of marks, that are shown
MAX_KEPT = 64  # images, saliences and answers that stay in memory between clicks
ESSENTIALS = "edit3r weights get essentials"
Known = TypeVar("Known")


@dataclass(frozen=True)
class _Analysis:
    """An image at working size and everything read from it."""

    pixels: np.ndarray  # [H, W, 3] uint8 RGB
    superpixels: Superpixels
    background: np.ndarray  # [H, W], background weight per pixel
    members: np.ndarray  # [R, N] bool, superpixels of every candidate region

    def masks(self) -> Iterator[np.ndarray]:
        """Yield every candidate region as a bool mask `[H, W]`."""
        return (row[self.superpixels.labels] for row in self.members)

    def measure(
        self, mask: np.ndarray, areas: tuple[float, float] = (0.0, 1.0)
    ) -> Objectness | None:
        """Measure a bool mask `[H, W]`; None when its share of the image is outside `areas`."""
        return measure(mask, self.superpixels, self.background, areas)


class ClassicalSegmenter(Segmenter):
    """Regions by colour and edges; `stability` and `predicted_iou` are proxies, not a network's
    opinion.
    """

    class Settings(edit3r.Settings):
        size: int = Field(256, ge=32, le=2048)
        """longer side of the picture while looking for objects [pixels]"""
        learned: bool = True
        """use learned salience where the weights u2netp are at hand"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._memory: dict[Hashable, Any] = {}
        self._remembering = threading.Lock()
        self._pixels: Latest[Hashable] = Latest()

    @remembered
    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        rgb = _to_numpy(image)
        analysis = self._analysis(rgb)
        subject = self._subject(rgb, analysis)
        measured = [
            (mask, analysis.measure(mask, (MIN_AREA, MAX_AREA)))
            for mask in analysis.masks()
        ]
        scored = _distinct(
            [(mask, cues) for mask, cues in measured if cues is not None]
        )
        refined = [_refined(analysis, *candidate) for candidate in scored[:REFINED]]
        chosen = _distinct(refined + scored[REFINED:])
        masks = [mask for mask, _ in chosen]
        masks[:REFINED] = [self._fine(rgb, mask) for mask in masks[:REFINED]]
        found = tuple(
            _proposal(rgb, mask, cues.quality, image)
            for mask, (_, cues) in zip(masks, chosen)
        )
        if subject is None:
            return found
        first = _proposal(rgb, self._fine(rgb, subject), 1.0, image)
        others = [
            p
            for p in found
            if overlap(*(q.soft_mask.numpy(force=True) > 0.5 for q in (p, first)))
            < SAME_OBJECT
        ]
        return (first, *others)[:MAX_OBJECTS]

    def _subject(self, rgb: np.ndarray, analysis: _Analysis) -> np.ndarray | None:
        """The subject of an image by learned salience, bool at working size; None without weights
        or subject.
        """
        seen = self._saliences(rgb, analysis.pixels.shape[:2], place=None)
        if not seen or (seen[0].values > 0.5).mean() < MIN_AREA:
            return None
        mask = seen[0].values > 0.5
        return tidied(mask, mask)

    def segment_marks(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> Proposal:
        rgb = _to_numpy(image)
        if marks.prior is not None and not (marks.inside or marks.negative):
            return self._expected(rgb, image, marks.prior)
        ordered, best = by_size(self._found(rgb, marks))
        place = min(max(best + marks.larger, 0), len(ordered) - 1)
        chosen = ordered[place]
        return self._drawn(rgb, image, marks, chosen)

    def readings(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> tuple[Proposal, ...]:
        """The most likely readings of the marks; each has its share of all their scores."""
        rgb = _to_numpy(image)
        all_found = self._found(rgb, marks)
        found = sorted(by_size(all_found)[0], key=all_found.index)
        total = sum(one.score for one in found)
        return tuple(
            replace(
                self._drawn(rgb, image, marks, one),
                confidence=float(one.score / total) if total else 0.0,
            )
            for one in found[:MAX_READINGS]
        )

    def _found(self, rgb: np.ndarray, marks: Marks) -> list[Candidate]:
        """All readings of marks, the best first."""
        analysis = self._analysis(rgb)
        shape = analysis.pixels.shape[:2]
        prior = None if marks.prior is None else _at_size(marks.prior, shape)
        evidence = Evidence(
            analysis.pixels,
            analysis.superpixels,
            analysis.members,
            analysis.measure,
            () if prior is not None else self._evident(rgb, shape, marks),
        )
        box = None if marks.box is None else _in_pixels(marks.box, shape)
        stroke = [_in_image(place, shape) for place in marks.drawn]
        return choose(evidence, _clicks(marks, shape), box, prior, stroke)

    def _drawn(
        self,
        rgb: np.ndarray,
        image: Float[Tensor, "3 height width"],
        marks: Marks,
        chosen: Candidate,
    ) -> Proposal:
        """A candidate as a proposal; its outline leaves no click on the wrong side."""
        cues = self._analysis(rgb).measure(chosen.mask)
        quality = 0.0 if cues is None else cues.quality
        fine = self._fine(rgb, chosen.mask)
        small = _clicks(marks, chosen.mask.shape)
        obeyed = all(chosen.mask[place] == inside for place, inside in small)
        said = _clicks(marks, fine.shape)
        if obeyed and any(fine[place] != inside for place, inside in said):
            fine = cv2.resize(chosen.mask.astype(np.uint8), fine.shape[::-1]) > 0
        return _proposal(rgb, fine, quality, image)

    def _expected(
        self,
        rgb: np.ndarray,
        image: Float[Tensor, "3 height width"],
        prior: Float[Tensor, "height width"],
    ) -> Proposal:
        """A mask from elsewhere with its outline moved; it says of itself how little it moved."""
        shape = reduced(rgb, self.settings.size).shape[:2]
        expected = _at_size(prior, shape)
        # A second round of the cut takes half as long again and changes 0.2 % of a mask.
        fine = self._fine(rgb, expected, rounds=1)
        moved = cv2.resize(fine.astype(np.uint8), shape[::-1]) > 0
        return _proposal(rgb, fine, overlap(moved, expected), image)

    def _evident(
        self, rgb: np.ndarray, shape: tuple[int, int], marks: Marks
    ) -> tuple[Salience, ...]:
        """Learned salience of the image and of crops around what is marked."""
        if marks.box is None:
            sides = [share * max(rgb.shape[:2]) for share in CROPS]
            first = marks.inside[0]
            return self._saliences(rgb, shape, first, sides)
        x, y, width, height = marks.box
        side = 1.4 * max(width * rgb.shape[1], height * rgb.shape[0])
        return self._saliences(rgb, shape, (x + width / 2, y + height / 2), [side])

    def _saliences(
        self,
        rgb: np.ndarray,
        shape: tuple[int, int],
        place: tuple[float, float] | None,
        sides: Sequence[float] = (),
    ) -> tuple[Salience, ...]:
        """Learned salience of the image and of crops around a place (x, y in [0, 1]) with `sides`
        [pixels]; none without weights.
        """
        if not self.settings.learned:
            return ()
        weights = at_hand(U2NETP)
        if weights is None:
            warn(
                "objects are told by colours and edges alone; small learned networks find whole "
                f"things much more often: {ESSENTIALS} ({U2NETP.name} alone: {U2NETP.terms})"
            )
            return ()
        height, width = rgb.shape[:2]
        windows = [(0, 0, max(height, width), WHOLE_SIDE)]
        for side in (max(16, round(side)) for side in sides):
            assert place is not None  # sides are given with a place
            x, y = place
            top = np.clip(y * height - side / 2, 0, max(0, height - side))
            left = np.clip(x * width - side / 2, 0, max(0, width - side))
            windows.append((int(top), int(left), side, CROP_SIDE))
        pixels = to_bytes(rgb)
        key, read = self._key_of(rgb), reader(weights)
        try:
            return tuple(
                self._kept(
                    (key, window), partial(_salience, read, pixels, window, shape)
                )
                for window in windows
            )
        except (cv2.error, IndexError):
            raise InputError(
                f"{weights}: is no whole U²-Net as ONNX; fetch it anew with: {U2NETP.get}"
            ) from None

    def _kept(self, key: Hashable, compute: Callable[[], Known]) -> Known:
        """What was computed for the same picture before: clicks follow each other on one
        picture, and may come from several threads.
        """
        with self._remembering:
            if key in self._memory:
                self._memory[key] = known = self._memory.pop(key)
                return known
        known = compute()
        with self._remembering:
            if len(self._memory) >= MAX_KEPT:  # what was asked for longest ago goes
                del self._memory[next(iter(self._memory))]
            self._memory[key] = known
        return known

    @remembered
    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """Look up the sky, the ground, the background and everything; None for any other words."""
        word = plain(text)
        if word == "everything" or (word in WHOLE and _says_all(text)):
            return (as_proposal(torch.ones_like(image[0])),)
        if word == "background":
            return self._background(image)
        if word not in STUFF:
            return None
        rgb = _to_numpy(image)
        analysis = self._analysis(rgb)
        mask, confidence = stuff(word, analysis.pixels, analysis.superpixels)
        if not mask.any():
            return ()
        found = _proposal(rgb, self._fine(rgb, mask), 0.5, image)
        return (replace(found, confidence=confidence),)

    def _background(
        self, image: Float[Tensor, "3 height width"]
    ) -> tuple[Proposal, ...]:
        """All but what stands out most, as surely as that is one clear thing."""
        warn("the background is taken to be all but what stands out most on the photo.")
        rgb = _to_numpy(image)
        shape = self._analysis(rgb).pixels.shape[:2]
        seen = self._saliences(rgb, shape, place=None)
        confidence = clearness(seen[0].values) if seen else 0.0
        return tuple(
            replace(
                as_proposal(1 - subject.soft_mask),
                confidence=max(UNCLEAR_CONFIDENCE, confidence),
            )
            for subject in self.propose(image)[:1]
        )

    def _analysis(self, rgb: np.ndarray) -> _Analysis:
        key = self._key_of(rgb)
        return self._kept(key, lambda: _analyse(rgb, self.settings.size))

    def _key_of(self, rgb: np.ndarray) -> Hashable:
        return self._pixels.of(rgb, lambda: (rgb.shape, hash(rgb.tobytes())))

    def _fine(self, rgb: np.ndarray, mask: np.ndarray, rounds: int = 2) -> np.ndarray:
        """Snap the outline of a bool mask `[h, w]` found at working size once more, at tracking
        size.
        """
        larger = to_bytes(reduced(rgb, tracking.LONGER))
        enlarged = (
            cv2.resize(
                mask.astype(np.float32),
                larger.shape[1::-1],
                interpolation=cv2.INTER_LINEAR,
            )
            > 0.5
        )
        moved = snapped(larger, enlarged, *SNAP_FINE, rounds=rounds)
        return moved if overlap(moved, enlarged) > 0.7 else enlarged

    @remembered
    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        return tracking.tracks(images, masks)


def _analyse(rgb: np.ndarray, size: int) -> _Analysis:
    """Read everything from a float RGB image `[H, W, 3]` at the working size."""
    small = reduced(rgb, size)
    cells = superpixels(small)
    weights = background_weights(cells)
    return _Analysis(to_bytes(small), cells, weights[cells.labels], merge_tree(cells))


def _distinct(
    candidates: list[tuple[np.ndarray, Objectness]],
) -> list[tuple[np.ndarray, Objectness]]:
    """Keep the most salient of each group of candidates (bool `[H, W]`) that overlap, most salient
    first.
    """
    kept: list[tuple[np.ndarray, Objectness]] = []
    for mask, cues in sorted(candidates, key=lambda c: -c[1].salience):
        if len(kept) == MAX_OBJECTS:
            break
        if all(overlap(mask, other) < SAME_OBJECT for other, _ in kept):
            kept.append((mask, cues))
    return kept


def _refined(
    analysis: _Analysis, mask: np.ndarray, cues: Objectness
) -> tuple[np.ndarray, Objectness]:
    """Snap the outline of a candidate (bool `[H, W]`) to edges, unless that makes it less of an
    object.
    """
    moved = snapped(analysis.pixels, mask, *SNAP)
    moved_cues = analysis.measure(moved, (MIN_AREA, MAX_AREA))
    return (
        (moved, moved_cues)
        if moved_cues is not None and moved_cues.salience > 0.8 * cues.salience
        else (mask, cues)
    )


def _clicks(marks: Marks, shape: tuple[int, int]) -> list[Click]:
    """Rows and columns of the clicks, those on the object first."""
    said = [(place, True) for place in marks.positive]
    said += [(place, False) for place in marks.negative]
    return [(_in_image(place, shape), inside) for place, inside in said]


def _in_image(place: tuple[float, float], shape: tuple[int, int]) -> tuple[int, int]:
    """Row and column of a place x, y in [0, 1]."""
    (x, y), (height, width) = place, shape
    return min(int(y * height), height - 1), min(int(x * width), width - 1)


def _in_pixels(box: tuple[float, float, float, float], shape: tuple[int, int]) -> Box:
    """First row and column of a box in [0, 1], and the first ones beyond it."""
    height, width = shape
    top, left = int(box[1] * height), int(box[0] * width)
    bottom = round((box[1] + box[3]) * height)
    right = round((box[0] + box[2]) * width)
    return (top, left), (max(bottom, top + 1), max(right, left + 1))


def _at_size(mask: Float[Tensor, "height width"], shape: tuple[int, int]) -> np.ndarray:
    """A soft mask as a bool one of another size."""
    values = mask.detach().cpu().numpy().astype(np.float32)
    return cv2.resize(values, shape[::-1]) > 0.5


def _salience(
    read: Callable[[], cv2.dnn.Net],
    pixels: np.ndarray,
    window: tuple[int, int, int, int],
    shape: tuple[int, int],
) -> Salience:
    """Learned salience of a window (top, left, side, side as the network sees it) of `pixels`, at
    working size.
    """
    top, left, side, seen = window
    values = np.zeros(pixels.shape[:2], np.float32)
    known = np.zeros(pixels.shape[:2], np.uint8)
    crop = np.s_[top : top + side, left : left + side]
    values[crop] = salience(read, np.ascontiguousarray(pixels[crop]), seen)
    known[crop] = 1
    return Salience(
        cv2.resize(values, shape[::-1], interpolation=cv2.INTER_AREA),
        cv2.resize(known, shape[::-1], interpolation=cv2.INTER_NEAREST) > 0,
    )


def _proposal(
    rgb: np.ndarray,
    mask: np.ndarray,
    quality: float,
    like: Float[Tensor, "3 height width"],
) -> Proposal:
    """Make a bool mask of any size a proposal on the image `[H, W, 3]`, its soft edge following the
    image's own.
    """
    soft = softened(rgb, mask)
    inside = soft > 0.5
    outline = inside if inside.any() else soft > 0
    left, top, across, down = cv2.boundingRect(outline.astype(np.uint8))
    box = (float(left), float(top), float(across), float(down))
    stability = overlap(soft > 0.35, soft > 0.65)
    return Proposal(
        torch.from_numpy(soft).to(like), float(inside.mean()), stability, quality, box
    )


def _to_numpy(image: Float[Tensor, "3 height width"]) -> np.ndarray:
    """Turn an image into float32 RGB `[H, W, 3]`."""
    return np.ascontiguousarray(image.detach().cpu().float().permute(1, 2, 0).numpy())


def _says_all(text: str) -> bool:
    """Whether a photo and not a thing on it is meant: "the picture" may hang on a wall."""
    words = text.lower().split()
    return "picture" not in words or bool({"whole", "entire", "all"} & {*words})
