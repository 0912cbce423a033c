"""Segmentation without learned weights: an offline stand-in with SAM2's outputs.

An image is cut into superpixels, merged region by region into a tree; every region of the tree is a
candidate and is judged by its outline, its difference from what surrounds it, and its place in the
image. It knows colours and edges, not things: an object of several colours comes in parts, and
words mean nothing to it.
"""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.cache import remembered
from edit3r.config import Settings
from edit3r.contract.interfaces import Marks, Proposal, Segmenter, Tracks, as_proposal
from edit3r.plugins.weights import at_hand
from edit3r.reporting import warn
from edit3r_segmenters import U2NETP, tracking
from edit3r_segmenters.interactive import Glimpse, Picture, find
from edit3r_segmenters.masks import (
    graph_cut,
    overlap,
    reduced,
    snapped,
    softened,
    tidied,
    to_bytes,
)
from edit3r_segmenters.salience import MAX_AREA, MIN_AREA, Objectness, measure, salience
from edit3r_segmenters.superpixels import (
    Superpixels,
    background_weights,
    merge_tree,
    superpixels,
)

SAME_OBJECT = 0.6  # intersection over union above which two candidates are one object
SNAP = (
    0.06,
    0.25,
)  # how far an outline may move in and out when it is refined [square roots of the area]
SNAP_FINE = (0.04, 0.04)  # the same for the second time, on the larger image
CROPS = (
    0.5,
    0.35,
    0.25,
    0.16,
)  # sides of the crops around a click [longer sides of the picture]
WHOLE_SIDE, CROP_SIDE = (
    320,
    160,
)  # what the learned network sees of a picture and of a crop [pixels]
# Words for stuff that needs no learning: where it lies and what it looks like
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
MOST_KEPT = 64  # pictures and glimpses that stay in memory between clicks
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

    class Settings(Settings):
        size: int = Field(
            256,
            ge=32,
            le=2048,
            description="longer side of the picture while looking for objects [pixels]",
        )
        max_objects: int = Field(
            24,
            ge=1,
            le=500,
            description="how many candidates `propose` returns at most",
        )
        refined: int = Field(
            4,
            ge=0,
            le=500,
            description="how many of the most salient get their outline refined",
        )
        learned: bool = Field(
            True,
            description="use learned salience where the weights u2netp are at hand",
        )
        track_size: int = Field(
            512,
            ge=64,
            le=4096,
            description="longer side of the picture while following [pixels]",
        )

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._memory: dict[Hashable, Any] = {}

    @remembered
    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        rgb = _to_numpy(image)
        analysis = self._analysis(rgb)
        subject = self._subject(rgb, analysis)
        scored = [
            (mask, analysis.measure(mask, (MIN_AREA, MAX_AREA)))
            for mask in analysis.masks()
        ]
        scored = _distinct(
            [(mask, cues) for mask, cues in scored if cues is not None],
            self.settings.max_objects,
        )
        refined = [
            _refined(analysis, *candidate)
            for candidate in scored[: self.settings.refined]
        ]
        chosen = _distinct(
            refined + scored[self.settings.refined :], self.settings.max_objects
        )
        masks = [mask for mask, _ in chosen]
        masks[: self.settings.refined] = [
            self._fine(rgb, mask) for mask in masks[: self.settings.refined]
        ]
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
        return (first, *others)[: self.settings.max_objects]

    def _subject(self, rgb: np.ndarray, analysis: _Analysis) -> np.ndarray | None:
        """The subject of a picture by learned salience, bool at working size; None without weights
        or subject.
        """
        glimpses = self._glimpses(rgb, analysis.pixels.shape[:2], Marks())
        if not glimpses or (glimpses[0].values > 0.5).mean() < MIN_AREA:
            return None
        mask = glimpses[0].values > 0.5
        return tidied(mask, mask)

    def segment_marks(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> Proposal:
        rgb = _to_numpy(image)
        if marks.prior is not None and not (
            marks.positive or marks.negative
        ):  # only its outline is looked at
            shape = reduced(rgb, self.settings.size).shape[1::-1]
            prior = (
                cv2.resize(marks.prior.detach().cpu().numpy().astype(np.float32), shape)
                > 0.5
            )
            fine = self._fine(rgb, prior)
            return _proposal(
                rgb,
                fine,
                overlap(cv2.resize(fine.astype(np.uint8), shape) > 0, prior),
                image,
            )
        analysis = self._analysis(rgb)
        shape = analysis.pixels.shape[:2]
        positive, negative = (
            _seeds(marks.positive, shape),
            _seeds(marks.negative, shape),
        )
        glimpses = self._glimpses(rgb, shape, marks)
        picture = Picture(
            analysis.pixels,
            analysis.superpixels,
            analysis.members,
            analysis.measure,
            glimpses,
        )
        prior = None
        if marks.prior is not None:
            prior = (
                cv2.resize(
                    marks.prior.detach().cpu().numpy().astype(np.float32), shape[::-1]
                )
                > 0.5
            )
        elif marks.box is not None:
            prior = _in_box(picture, marks.box, positive)
        mask = (
            find(picture, positive, negative, prior) if positive or negative else prior
        )
        cues = analysis.measure(mask)
        fine = self._fine(rgb, mask)
        said = [(spot, True) for spot in _seeds(marks.positive, fine.shape)]
        said += [(spot, False) for spot in _seeds(marks.negative, fine.shape)]
        if any(fine[spot] != wanted for spot, wanted in said):
            fine = cv2.resize(mask.astype(np.uint8), fine.shape[::-1]) > 0
        return _proposal(rgb, fine, cues.quality if cues is not None else 0.0, image)

    def _glimpses(
        self, rgb: np.ndarray, shape: tuple[int, int], marks: Marks
    ) -> tuple[Glimpse, ...]:
        """Learned salience of the picture and of what surrounds the first mark; none without
        weights.
        """
        if marks.prior is not None:
            return ()
        weights = at_hand(U2NETP) if self.settings.learned else None
        if weights is None:
            if self.settings.learned:
                warn(
                    "objects are told by colours and edges alone; a small learned network finds "
                    "whole things much more "
                    f"often: edit3r weights get {U2NETP.name} ({U2NETP.terms})"
                )
            return ()
        pixels, longer, key = (
            to_bytes(rgb),
            max(rgb.shape[:2]),
            (rgb.shape, hash(rgb.tobytes())),
        )
        windows = [(0, 0, longer, WHOLE_SIDE)]
        if marks.box is not None:
            x, y, width, height = marks.box
            places, sides = (
                [(x + width / 2, y + height / 2)],
                (1.4 * max(width * rgb.shape[1], height * rgb.shape[0]),),
            )
        else:
            places, sides = marks.positive[:1], [share * longer for share in CROPS]
        for x, y in places:
            for side in (max(16, round(side)) for side in sides):
                top = int(
                    np.clip(y * rgb.shape[0] - side / 2, 0, max(0, rgb.shape[0] - side))
                )
                left = int(
                    np.clip(x * rgb.shape[1] - side / 2, 0, max(0, rgb.shape[1] - side))
                )
                windows.append((top, left, side, CROP_SIDE))
        return tuple(
            self._kept(
                (key, window),
                lambda window=window: _glimpse(weights, pixels, window, shape),
            )
            for window in windows
        )

    def _kept(self, key: Hashable, compute: Callable[[], Known]) -> Known:
        """What was computed for the same picture before: clicks follow each other on one
        picture.
        """
        if key not in self._memory:
            if len(self._memory) >= MOST_KEPT:
                self._memory.clear()
            self._memory[key] = compute()
        return self._memory[key]

    @remembered
    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """Look up the sky, the ground, the background and everything; None for any other words."""
        word = plain(text)
        if word in ("everything", "picture", "image", "photo", "scene"):
            return (as_proposal(torch.ones_like(image[0])),)
        if word == "background":
            subjects = self.propose(image)[:1]
            warn(
                "the background is taken to be all but what stands out most on the photo."
            )
            return tuple(as_proposal(1 - subject.soft_mask) for subject in subjects)
        if word not in ("sky", "ground", "floor"):
            return None
        rgb = _to_numpy(image)
        analysis = self._analysis(rgb)
        mask = (
            sky(analysis.pixels, analysis.superpixels)
            if word == "sky"
            else ground(analysis.pixels)
        )
        return (
            ()
            if mask is None or not mask.any()
            else (_proposal(rgb, self._fine(rgb, mask), 0.5, image),)
        )

    def _analysis(self, rgb: np.ndarray) -> _Analysis:
        return self._kept(
            (rgb.shape, hash(rgb.tobytes())), lambda: _analyse(rgb, self.settings.size)
        )

    def _fine(self, rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Snap the outline of a bool mask `[h, w]` found at working size once more, at tracking
        size.
        """
        larger = to_bytes(reduced(rgb, self.settings.track_size))
        enlarged = (
            cv2.resize(
                mask.astype(np.float32),
                larger.shape[1::-1],
                interpolation=cv2.INTER_LINEAR,
            )
            > 0.5
        )
        moved = snapped(larger, enlarged, *SNAP_FINE, rounds=2)
        return moved if overlap(moved, enlarged) > 0.7 else enlarged

    @remembered
    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        soft, present = tracking.follow(
            [_to_numpy(image) for image in images],
            masks.detach().cpu().numpy(),
            self.settings.track_size,
        )
        soft, present = (
            torch.from_numpy(soft).to(images),
            torch.from_numpy(present).to(images.device),
        )
        logits = torch.where(
            soft > 0.5, soft.logit(1e-4), soft.logit(1e-4).clamp(max=0)
        )
        return Tracks(
            torch.where(present[..., None, None], logits, logits.clamp(max=-1e-3)),
            present,
        )


def _analyse(rgb: np.ndarray, size: int) -> _Analysis:
    """Read everything from a float RGB image `[H, W, 3]` at the working size."""
    small = reduced(rgb, size)
    cells = superpixels(small)
    weights = background_weights(cells)
    return _Analysis(to_bytes(small), cells, weights[cells.labels], merge_tree(cells))


def _distinct(
    candidates: list[tuple[np.ndarray, Objectness]], limit: int
) -> list[tuple[np.ndarray, Objectness]]:
    """Keep the most salient of each group of candidates (bool `[H, W]`) that overlap, most salient
    first.
    """
    kept: list[tuple[np.ndarray, Objectness]] = []
    for mask, cues in sorted(candidates, key=lambda c: -c[1].salience):
        if len(kept) == limit:
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


def _seeds(
    points: Sequence[tuple[float, float]], shape: tuple[int, int]
) -> list[tuple[int, int]]:
    """Find row and column of points (x, y) that are normalised to [0, 1]."""
    height, width = shape
    return [
        (min(int(y * height), height - 1), min(int(x * width), width - 1))
        for x, y in points
    ]


def _glimpse(
    weights: Path,
    pixels: np.ndarray,
    window: tuple[int, int, int, int],
    shape: tuple[int, int],
) -> Glimpse:
    """Learned salience of a window (top, left, side, side as the network sees it) of `pixels`, at
    working size.
    """
    top, left, side, seen = window
    values, known = (
        np.zeros(pixels.shape[:2], np.float32),
        np.zeros(pixels.shape[:2], np.uint8),
    )
    crop = np.s_[top : top + side, left : left + side]
    values[crop], known[crop] = (
        salience(weights, np.ascontiguousarray(pixels[crop]), seen),
        1,
    )
    values = cv2.resize(values, shape[::-1], interpolation=cv2.INTER_AREA)
    return Glimpse(
        values, cv2.resize(known, shape[::-1], interpolation=cv2.INTER_NEAREST) > 0
    )


def _in_box(
    picture: Picture,
    box: tuple[float, float, float, float],
    seeds: list[tuple[int, int]],
) -> np.ndarray:
    """The object in a box: of a graph cut with all outside as background, and of what stands out
    there, the better.
    """
    height, width = picture.pixels.shape[:2]
    left, top = int(box[0] * width), int(box[1] * height)
    right, bottom = round((box[0] + box[2]) * width), round((box[1] + box[3]) * height)
    inside = np.zeros((height, width), dtype=bool)
    inside[top : max(bottom, top + 1), left : max(right, left + 1)] = True
    trimap = np.where(inside, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    for seed in seeds:
        trimap[seed] = cv2.GC_FGD
    candidates = [graph_cut(picture.pixels, trimap, rounds=5)]
    candidates += [inside & (glimpse.values > 0.5) for glimpse in picture.glimpses]
    candidates = [
        tidied(mask, inside) for mask in candidates if mask.sum() > 0.05 * inside.sum()
    ]
    filled = [
        overlap(_bounds(mask), inside) * picture.quality(mask, ())
        for mask in candidates
    ]
    return (
        candidates[int(np.argmax(filled))] if candidates else inside
    )  # nothing in the box stands out: all of it


def _bounds(mask: np.ndarray) -> np.ndarray:
    """The smallest box around a bool mask, as one."""
    return mask.any(1)[:, None] & mask.any(0)[None]


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
    box = tuple(
        map(
            float,
            cv2.boundingRect((inside if inside.any() else soft > 0).astype(np.uint8)),
        )
    )
    stability = overlap(soft > 0.35, soft > 0.65)
    return Proposal(
        torch.from_numpy(soft).to(like), float(inside.mean()), stability, quality, box
    )


def _to_numpy(image: Float[Tensor, "3 height width"]) -> np.ndarray:
    """Turn an image into float32 RGB `[H, W, 3]`."""
    return np.ascontiguousarray(image.detach().cpu().float().permute(1, 2, 0).numpy())


def plain(text: str) -> str:
    """A name without case, article and other filler: 'the whole picture' is 'picture'."""
    return " ".join(
        word
        for word in text.lower().split()
        if word not in ("the", "a", "an", "whole", "entire", "all")
    )


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
