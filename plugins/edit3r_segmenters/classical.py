"""Segmentation without learned weights: an offline stand-in with SAM2's outputs.

An image is cut into superpixels, merged region by region into a tree; every region of the tree is a candidate and is
judged by its outline, its difference from what surrounds it, and its place in the image. It knows colours and
edges, not things: an object of several colours comes in parts, and words mean nothing to it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.cache import remembered
from edit3r.config import Settings
from edit3r.interfaces import Proposal, Segmenter, Tracks
from edit3r_segmenters import tracking
from edit3r_segmenters.masks import graph_cut, overlap, reduced, snapped, softened, tidied, to_bytes
from edit3r_segmenters.salience import MAX_AREA, MIN_AREA, Objectness, measure
from edit3r_segmenters.superpixels import Superpixels, background_weights, merge_tree, superpixels

SAME_OBJECT = 0.6  # intersection over union above which two candidates are one object
SNAP = (0.06, 0.25)  # how far an outline may move in and out when it is refined [square roots of the area]
SNAP_FINE = (0.04, 0.04)  # the same for the second time, on the larger image


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

    def measure(self, mask: np.ndarray, areas: tuple[float, float] = (0.0, 1.0)) -> Objectness | None:
        """Measure a bool mask `[H, W]`; None when its share of the image is outside `areas`."""
        return measure(mask, self.superpixels, self.background, areas)


class ClassicalSegmenter(Segmenter):
    """Regions by colour and edges; `stability` and `predicted_iou` are proxies, not a network's opinion."""

    class Settings(Settings):
        size: int = Field(
            256, ge=32, le=2048, description="longer side of the picture while looking for objects [pixels]"
        )
        max_objects: int = Field(24, ge=1, le=500, description="how many candidates `propose` returns at most")
        refined: int = Field(4, ge=0, le=500, description="how many of the most salient get their outline refined")
        track_size: int = Field(512, ge=64, le=4096, description="longer side of the picture while following [pixels]")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    @remembered
    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        rgb = _to_numpy(image)
        analysis = _analyse(rgb, self.settings.size)
        scored = [(mask, analysis.measure(mask, (MIN_AREA, MAX_AREA))) for mask in analysis.masks()]
        scored = _distinct([(mask, cues) for mask, cues in scored if cues is not None], self.settings.max_objects)
        refined = [_refined(analysis, *candidate) for candidate in scored[: self.settings.refined]]
        chosen = _distinct(refined + scored[self.settings.refined :], self.settings.max_objects)
        masks = [mask for mask, _ in chosen]
        masks[: self.settings.refined] = [self._fine(rgb, mask) for mask in masks[: self.settings.refined]]
        return tuple(_proposal(rgb, mask, cues.quality, image) for mask, (_, cues) in zip(masks, chosen))

    def segment(
        self,
        image: Float[Tensor, "3 height width"],
        points: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
    ) -> Proposal:
        if not points and box is None:
            raise ValueError("ClassicalSegmenter.segment: expected at least one point or a box, got neither")
        rgb = _to_numpy(image)
        analysis = _analyse(rgb, self.settings.size)
        seeds = _seeds(points, analysis.pixels.shape[:2])
        mask = _in_box(analysis, box, seeds) if box is not None else _at_points(analysis, seeds)
        cues = analysis.measure(mask)
        return _proposal(rgb, self._fine(rgb, mask), cues.quality if cues is not None else 0.0, image)

    def _fine(self, rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Snap the outline of a bool mask `[h, w]` found at working size once more, at tracking size."""
        larger = to_bytes(reduced(rgb, self.settings.track_size))
        enlarged = cv2.resize(mask.astype(np.float32), larger.shape[1::-1], interpolation=cv2.INTER_LINEAR) > 0.5
        moved = snapped(larger, enlarged, *SNAP_FINE, rounds=2)
        return moved if overlap(moved, enlarged) > 0.7 else enlarged

    @remembered
    def track(
        self, images: Float[Tensor, "view 3 height width"], masks: Float[Tensor, "object height width"]
    ) -> Tracks:
        soft, present = tracking.follow(
            [_to_numpy(image) for image in images], masks.detach().cpu().numpy(), self.settings.track_size
        )
        soft, present = torch.from_numpy(soft).to(images), torch.from_numpy(present).to(images.device)
        logits = torch.where(soft > 0.5, soft.logit(1e-4), soft.logit(1e-4).clamp(max=0))
        return Tracks(torch.where(present[..., None, None], logits, logits.clamp(max=-1e-3)), present)


def _analyse(rgb: np.ndarray, size: int) -> _Analysis:
    """Read everything from a float RGB image `[H, W, 3]` at the working size."""
    small = reduced(rgb, size)
    cells = superpixels(small)
    weights = background_weights(cells)
    return _Analysis(to_bytes(small), cells, weights[cells.labels], merge_tree(cells))


def _distinct(candidates: list[tuple[np.ndarray, Objectness]], limit: int) -> list[tuple[np.ndarray, Objectness]]:
    """Keep the most salient of each group of candidates (bool `[H, W]`) that overlap, most salient first."""
    kept: list[tuple[np.ndarray, Objectness]] = []
    for mask, cues in sorted(candidates, key=lambda c: -c[1].salience):
        if len(kept) == limit:
            break
        if all(overlap(mask, other) < SAME_OBJECT for other, _ in kept):
            kept.append((mask, cues))
    return kept


def _refined(analysis: _Analysis, mask: np.ndarray, cues: Objectness) -> tuple[np.ndarray, Objectness]:
    """Snap the outline of a candidate (bool `[H, W]`) to edges, unless that makes it less of an object."""
    moved = snapped(analysis.pixels, mask, *SNAP)
    moved_cues = analysis.measure(moved, (MIN_AREA, MAX_AREA))
    return (moved, moved_cues) if moved_cues is not None and moved_cues.salience > 0.8 * cues.salience else (mask, cues)


def _seeds(points: Sequence[tuple[float, float]], shape: tuple[int, int]) -> np.ndarray:
    """Find row and column `[P, 2]` of points (x, y) that are normalised to [0, 1]."""
    height, width = shape
    rows = [min(int(y * height), height - 1) for _, y in points]
    columns = [min(int(x * width), width - 1) for x, _ in points]
    return np.array([rows, columns], dtype=np.int64).T.reshape(-1, 2)


def _at_points(analysis: _Analysis, seeds: np.ndarray) -> np.ndarray:
    """Take the region that holds all points `[P, 2]` and is most of a thing; the points' own superpixels if none is."""
    cells = analysis.superpixels.labels[seeds[:, 0], seeds[:, 1]]
    best, best_score = np.isin(analysis.superpixels.labels, cells), 0.0
    for row in analysis.members[analysis.members[:, cells].all(1)]:
        mask = row[analysis.superpixels.labels]
        cues = analysis.measure(mask)
        if cues is not None and cues.as_part > best_score:
            best, best_score = mask, cues.as_part
    moved = snapped(analysis.pixels, best, *SNAP)
    return moved if moved[seeds[:, 0], seeds[:, 1]].all() else best


def _in_box(analysis: _Analysis, box: tuple[float, float, float, float], seeds: np.ndarray) -> np.ndarray:
    """Cut the object out of a box by graph cut, all outside being background; points `[P, 2]` inside are kept."""
    height, width = analysis.pixels.shape[:2]
    left, top = int(box[0] * width), int(box[1] * height)
    right, bottom = round((box[0] + box[2]) * width), round((box[1] + box[3]) * height)
    inside = np.zeros((height, width), dtype=bool)
    inside[top : max(bottom, top + 1), left : max(right, left + 1)] = True
    trimap = np.where(inside, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    trimap[seeds[:, 0], seeds[:, 1]] = cv2.GC_FGD
    mask = tidied(graph_cut(analysis.pixels, trimap, rounds=5), inside)
    return mask if mask.sum() > 0.05 * inside.sum() else inside  # nothing in the box stands out: all of it


def _proposal(rgb: np.ndarray, mask: np.ndarray, quality: float, like: Float[Tensor, "3 height width"]) -> Proposal:
    """Make a bool mask of any size a proposal on the image `[H, W, 3]`, its soft edge following the image's own."""
    soft = softened(rgb, mask)
    inside = soft > 0.5
    box = tuple(map(float, cv2.boundingRect((inside if inside.any() else soft > 0).astype(np.uint8))))
    stability = overlap(soft > 0.35, soft > 0.65)
    return Proposal(torch.from_numpy(soft).to(like), float(inside.mean()), stability, quality, box)


def _to_numpy(image: Float[Tensor, "3 height width"]) -> np.ndarray:
    """Turn an image into float32 RGB `[H, W, 3]`."""
    return np.ascontiguousarray(image.detach().cpu().float().permute(1, 2, 0).numpy())
