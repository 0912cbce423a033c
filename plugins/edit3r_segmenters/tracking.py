"""Follow objects from the first view through the others, by features and dense flow.

View by view, from the last earlier view that showed the object: an affine map of SIFT matches on
it, where enough agree, then dense inverse-search flow with a forward-backward check. The outline is
snapped to the colours of the new view. An object of which too little leads back, or that looks
different, is reported lost.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Tracks
from edit3r.kit.compute.outlines import distance_to, overlap, softened
from edit3r_segmenters.masks import reduced, snapped, to_bytes

LONGER = 512  # longer side of the pictures while following [pixels]
MIN_CONSISTENT = 0.35  # share under which flow says nothing
# how far the outline may move when it is snapped [square roots of the area]
SNAP_BAND = 0.04
MIN_LIKENESS = 0.5  # overlap of colour histograms under which it is not the same object

# Dense flow
SMALLEST = 24  # below this side length [pixels] the flow's patches do not fit
# allowed forward-backward error: pixels, plus a share of the movement
ERROR_FLOOR, ERROR_SLOPE = 1.5, 0.05

# Features
RATIO = 0.8  # Lowe's test: best match at most this share of the second best distance
MIN_MATCHES = 8  # agreeing matches without which the object counts as not found
AGREEMENT = (
    0.02  # distance from the affine map at which a match agrees [image diagonals]
)
MAX_STRETCH = 3.0  # largest change of size between two views of an object
# largest ratio of the stretches along two axes: a surface seen 60 degrees from the side
MAX_SQUEEZE = 2.0
# an affine map must win this many times the matches of a similarity to be preferred
FREEDOM_PRICE = 1.25


@dataclass(frozen=True)
class Flow:
    """Movement between a source and a target view."""

    # float32 [H, W, 2], x and y from source to target [pixels], on the source's grid
    forward: np.ndarray
    # float32 [H, W, 2], from target to source, on the target's grid
    backward: np.ndarray
    # bool [H, W], source pixels that come back to where they started
    leaves: np.ndarray
    arrives: np.ndarray  # bool [H, W], the same for the target's pixels


@dataclass(frozen=True)
class _View:
    """A view at tracking size."""

    pixels: np.ndarray  # uint8 RGB [h, w, 3]
    grey: np.ndarray  # uint8 [h, w]


def tracks(
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "object height width"],
) -> Tracks:
    """`follow` on tensors: what a segmenter's `track` returns."""
    pixels = images.detach().cpu().float().permute(0, 2, 3, 1).numpy()
    frames = [np.ascontiguousarray(one) for one in pixels]
    found, seen = follow(frames, masks.detach().cpu().numpy())
    soft = torch.from_numpy(found).to(images)
    return Tracks(soft.logit(1e-4), torch.from_numpy(seen).to(images.device))


def follow(
    images: list[np.ndarray], masks: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Follow `masks` `[R, H, W]` on the first of `images` (float RGB `[H, W, 3]`, one size) through
    all of them.

    Returns soft masks float32 `[V, R, H, W]` in [0, 1], zero where lost, and bool `[V, R]`: which
    view shows which.
    """
    views = [_view(image) for image in images]
    height, width = views[0].grey.shape
    first = [
        cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA) > 0.5
        for mask in masks.astype(np.float32)
    ]
    found: list[list[np.ndarray | None]] = [
        [mask if mask.any() else None for mask in first]
    ]
    for view in range(1, len(views)):
        found.append([_found_again(views, found, view, n) for n in range(len(masks))])
    soft = np.zeros((len(views), len(masks), *images[0].shape[:2]), np.float32)
    present = np.zeros(soft.shape[:2], dtype=bool)
    for index, row in enumerate(found):
        for number, mask in enumerate(row):
            if mask is not None:
                soft[index, number] = (
                    masks[number] if index == 0 else softened(images[index], mask)
                )
                present[index, number] = True
    return soft, present


def _view(image: np.ndarray) -> _View:
    """Reduce a float RGB image `[H, W, 3]` to tracking size."""
    pixels = to_bytes(reduced(image, LONGER))
    return _View(pixels, cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))


def _found_again(
    views: list[_View], found: list[list[np.ndarray | None]], index: int, number: int
) -> np.ndarray | None:
    """An object in one view by the last one that showed it; None when it is lost."""
    shown = [view for view, row in enumerate(found) if row[number] is not None]
    if not shown:
        return None
    here, source = views[index], views[shown[-1]]
    mask, grey = found[shown[-1]][number], source.grey
    assert mask is not None
    matrix = affine_between(grey, here.grey, mask)
    if matrix is not None:
        size = here.grey.shape[::-1]
        mask = cv2.warpAffine(mask.astype(np.float32), matrix, size) > 0.5
        rim = cv2.BORDER_REPLICATE
        grey = cv2.warpAffine(grey, matrix, size, borderMode=rim)
    if not mask.any():
        return None
    moved, sure, consistent = carry(mask, flow_between(grey, here.grey))
    if consistent >= MIN_CONSISTENT:
        moved = _on_colours(here.pixels, moved, SNAP_BAND, moved & ~sure)
    elif matrix is not None:
        moved = _on_colours(here.pixels, mask, 3 * SNAP_BAND)
    else:
        return None
    first = found[0][number]
    assert first is not None
    alike = _likeness(views[0].pixels, first, here.pixels, moved)
    return moved if alike >= MIN_LIKENESS else None


def _on_colours(
    pixels: np.ndarray, mask: np.ndarray, band: float, unsure: np.ndarray | None = None
) -> np.ndarray:
    """A mask `[h, w]` with its outline on the colours of a view, and without what of it is unsure
    where colours would change the rest.
    """
    moved = snapped(pixels, mask, band, band, rounds=2, unsure=unsure)
    rest = mask if unsure is None else mask & ~unsure
    return moved if overlap(moved | (mask & ~rest), mask) > 0.7 else rest


def _likeness(
    one: np.ndarray, one_mask: np.ndarray, other: np.ndarray, other_mask: np.ndarray
) -> float:
    """Overlap in [0, 1] of the colour histograms of two images `[H, W, 3]` under masks `[H, W]`."""
    first, second = _histogram(one, one_mask), _histogram(other, other_mask)
    return float(np.sqrt(first * second).sum())


def _histogram(pixels: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Count Lab colours of uint8 RGB `[H, W, 3]` under a mask, smoothed and summing to 1: `[6, 16,
    16]`.
    """
    lab = cv2.cvtColor(pixels, cv2.COLOR_RGB2LAB)
    counts = cv2.calcHist(
        [lab], [0, 1, 2], mask.astype(np.uint8), [6, 16, 16], [0, 256, 0, 256, 0, 256]
    )
    smooth = cv2.GaussianBlur(counts.reshape(6, -1), (1, 3), 0.7).reshape(6, 16, 16)
    smooth = np.stack([cv2.GaussianBlur(plane, (3, 3), 0.7) for plane in smooth])
    return smooth / max(smooth.sum(), 1e-9)


def flow_between(source: np.ndarray, target: np.ndarray) -> Flow:
    """Compute dense flow both ways between two grey uint8 images `[H, W]`."""
    height, width = source.shape
    if min(height, width) < SMALLEST:
        still = np.zeros((height, width, 2), np.float32)
        nowhere = np.zeros((height, width), dtype=bool)
        return Flow(still, still, nowhere, nowhere)
    engine = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    engine.setFinestScale(0)
    forward, backward = (
        engine.calc(source, target, None),  # type: ignore[call-overload]
        engine.calc(target, source, None),  # type: ignore[call-overload]
    )
    return Flow(
        forward, backward, _returns(forward, backward), _returns(backward, forward)
    )


def carry(mask: np.ndarray, flow: Flow) -> tuple[np.ndarray, np.ndarray, float]:
    """Carry the source's bool mask `[H, W]` to the target's grid.

    Returns it, the part of it that leads back to where it came from, and the share in [0, 1] of the
    source's mask that arrives somewhere and leads back.
    """
    height, width = mask.shape
    came_from = _grid(height, width) + flow.backward
    warped = (
        cv2.remap(
            mask.astype(np.float32),
            came_from[..., 0],
            came_from[..., 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        )
        > 0.5
    )
    return (
        warped,
        warped & flow.arrives,
        float(flow.leaves[mask].mean()) if mask.any() else 0.0,
    )


def _returns(there: np.ndarray, back: np.ndarray) -> np.ndarray:
    """Tell which pixels return when they follow `there`, then `back`: bool `[H, W]` of two flows
    `[H, W, 2]`.
    """
    height, width = there.shape[:2]
    landed = _grid(height, width) + there
    returned = cv2.remap(
        back,
        landed[..., 0],
        landed[..., 1],
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(1e4, 1e4),
    )
    error = np.linalg.norm(there + returned, axis=2)
    return error < ERROR_FLOOR + ERROR_SLOPE * np.linalg.norm(there, axis=2)


def _grid(height: int, width: int) -> np.ndarray:
    """x and y of every pixel, float32 `[H, W, 2]`."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), 2).astype(
        np.float32
    )


def affine_between(
    source: np.ndarray, target: np.ndarray, mask: np.ndarray
) -> np.ndarray | None:
    """Find the affine map `[2, 3]` from the source's object to the target; None when too few
    matches agree on one.

    Grey uint8 images and a bool mask, all `[H, W]`. A similarity is taken unless an affine
    map explains clearly more matches.
    """
    pairs = _matches(source, target, mask)
    if pairs is None or len(pairs[0]) < MIN_MATCHES:
        return None
    tolerance = AGREEMENT * float(np.hypot(*source.shape))
    similarity, agreeing = _fit(cv2.estimateAffinePartial2D, pairs, tolerance)
    affine, more_agreeing = _fit(cv2.estimateAffine2D, pairs, tolerance)
    matrix, count = (
        (affine, more_agreeing)
        if more_agreeing > FREEDOM_PRICE * agreeing
        else (similarity, agreeing)
    )
    return matrix if count >= MIN_MATCHES else None


def _fit(
    estimate: Callable, pairs: tuple[np.ndarray, np.ndarray], tolerance: float
) -> tuple[np.ndarray | None, int]:
    """Fit a map `[2, 3]` to pairs of positions `[M, 2]`, and count those that agree; None: not
    plausible.
    """
    cv2.setRNGSeed(0)
    matrix, agreeing = estimate(
        *pairs, method=cv2.RANSAC, ransacReprojThreshold=tolerance, maxIters=5000
    )
    return (
        (matrix, int(agreeing.sum()))
        if matrix is not None and _is_plausible(matrix)
        else (None, 0)
    )


def _matches(
    source: np.ndarray, target: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Match the features on the object: their positions `[M, 2]` in both views [pixels]."""
    on_object = (distance_to(mask) <= 3).astype(np.uint8)
    first, first_descriptors = _features().detectAndCompute(source, on_object)
    second, second_descriptors = _features_of(target.tobytes(), target.shape)
    if first_descriptors is None or second_descriptors is None or len(second) < 2:
        return None
    candidates = cv2.BFMatcher().knnMatch(first_descriptors, second_descriptors, k=2)
    good = [
        best for best, other in candidates if best.distance < RATIO * other.distance
    ]
    here = np.array([first[match.queryIdx].pt for match in good], np.float32).reshape(
        -1, 2
    )
    there = np.array([second[match.trainIdx].pt for match in good], np.float32).reshape(
        -1, 2
    )
    return here, there


def _features() -> cv2.SIFT:
    return cv2.SIFT.create(nfeatures=4000, contrastThreshold=0.02)


@lru_cache(maxsize=4)
def _features_of(grey: bytes, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Features of a whole view, for clicks that follow each other."""
    whole = np.frombuffer(grey, np.uint8).reshape(shape)
    return _features().detectAndCompute(whole, None)


def _is_plausible(matrix: np.ndarray) -> bool:
    """Tell whether a map `[2, 3]` neither mirrors nor stretches more than a change of viewpoint
    does.
    """
    stretch = np.linalg.svd(matrix[:, :2], compute_uv=False)
    bounded = (
        stretch[0] < MAX_STRETCH
        and stretch[1] > 1 / MAX_STRETCH
        and stretch[0] < MAX_SQUEEZE * stretch[1]
    )
    return bool(bounded and np.linalg.det(matrix[:, :2]) > 0)
