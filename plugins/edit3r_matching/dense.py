"""Depth of every pixel of every placed view."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edit3r import reporting
from edit3r_matching.camera import Picture
from edit3r_matching.consistency import cross_check, without_speckles
from edit3r_matching.depth_map import RawDepth, inverse_depth_range, sweep_depth
from edit3r_matching.filling import fill
from edit3r_matching.free_space import push_back
from edit3r_matching.plane_sweep import Neighbour
from edit3r_matching.registration import Registration

__all__ = ["ViewDepth", "dense_depth"]

_TOLERANCE = 1.5  # planes by which two measurements of one surface may differ


@dataclass(frozen=True)
class ViewDepth:
    """Depth of one view at the working size."""

    inverse: np.ndarray  # [height, width] 1 / camera z, > 0, float32
    measured: np.ndarray  # [height, width] bool; False: filled in
    step: float  # inverse depth between two hypotheses: how finely it was measured


def dense_depth(
    pictures: Sequence[Picture], registration: Registration, neighbours: int, planes: int
) -> list[ViewDepth | None]:
    """Depth of each view from its best `neighbours`; None for a view that was not placed."""
    partners = [registration.partners(view)[:neighbours] for view in range(len(pictures))]
    raw = raw_depths(pictures, registration, partners, planes)
    return checked_depths(pictures, registration, partners, raw)


def raw_depths(
    pictures: Sequence[Picture], registration: Registration, partners: Sequence[Sequence[int]], planes: int
) -> dict[int, RawDepth]:
    """Unchecked depth of each placed view from its `partners`."""
    placed = [view for view in range(len(pictures)) if registration.registered[view]]
    raw = {}
    for view in reporting.track(placed, "measuring depth"):
        depths = np.concatenate([registration.shared_depths(view, other) for other in partners[view]])
        around = _neighbours(pictures, registration, view, partners[view])
        raw[view] = sweep_depth(pictures[view], around, inverse_depth_range(depths), planes)
    return raw


def checked_depths(
    pictures: Sequence[Picture],
    registration: Registration,
    partners: Sequence[Sequence[int]],
    raw: dict[int, RawDepth],
) -> list[ViewDepth | None]:
    """Keep what at least one partner confirms and fill the rest from it; None for a view without raw depth."""
    measured = {view: _measured(pictures, registration, view, partners[view], raw) for view in raw}
    return [
        _completed(pictures, registration, view, partners[view], raw, measured) if view in raw else None
        for view in range(len(pictures))
    ]


def _neighbours(
    pictures: Sequence[Picture], registration: Registration, view: int, others: Sequence[int]
) -> list[Neighbour]:
    return [Neighbour(pictures[other], registration.relative(view, other)) for other in others]


def _measured(
    pictures: Sequence[Picture], registration: Registration, view: int, others: Sequence[int], raw: dict[int, RawDepth]
) -> np.ndarray:
    """Pixels whose depth at least one other view confirms."""
    around = _neighbours(pictures, registration, view, others)
    agrees = [
        cross_check(raw[view].inverse, pictures[view], neighbour, raw[other], _TOLERANCE).agrees
        for other, neighbour in zip(others, around)
    ]
    return without_speckles(np.any(agrees, axis=0), raw[view])


def _completed(
    pictures: Sequence[Picture],
    registration: Registration,
    view: int,
    others: Sequence[int],
    raw: dict[int, RawDepth],
    measured: dict[int, np.ndarray],
) -> ViewDepth:
    """Spread what was measured over the rest, then push back what would hide a neighbour's surface."""
    own, sure = raw[view], measured[view]
    inverse = fill(own.inverse, sure, own.step, pictures[view].image)
    for other, neighbour in zip(others, _neighbours(pictures, registration, view, others)):
        inverse = push_back(inverse, sure, own, pictures[view], neighbour, raw[other], measured[other])
    return ViewDepth(np.where(sure, inverse, cv2.medianBlur(inverse, 5)), sure, own.step)
