"""Depth of every pixel of every placed view."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edit3r import reporting
from edit3r_classical.camera import Picture
from edit3r_classical.consistency import cross_check, without_speckles
from edit3r_classical.depth_map import RawDepth, inverse_depth_range, sweep_depth
from edit3r_classical.filling import fill
from edit3r_classical.plane_sweep import Neighbour
from edit3r_classical.registration import Registration

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
    placed = [view for view in range(len(pictures)) if registration.registered[view]]
    raw: dict[int, RawDepth] = {}
    for view in reporting.track(placed, "measuring depth"):
        depths = np.concatenate([registration.shared_depths(view, other) for other in partners[view]])
        around = _neighbours(pictures, registration, view, partners[view])
        raw[view] = sweep_depth(pictures[view], around, inverse_depth_range(depths), planes)
    return [
        _checked(pictures, registration, view, partners[view], raw) if view in raw else None
        for view in range(len(pictures))
    ]


def _neighbours(
    pictures: Sequence[Picture], registration: Registration, view: int, others: Sequence[int]
) -> list[Neighbour]:
    return [Neighbour(pictures[other], registration.relative(view, other)) for other in others]


def _checked(
    pictures: Sequence[Picture], registration: Registration, view: int, others: Sequence[int], raw: dict[int, RawDepth]
) -> ViewDepth:
    """Keep what at least one neighbour confirms and fill the rest from it."""
    own = raw[view]
    around = _neighbours(pictures, registration, view, others)
    checks = [
        cross_check(own.inverse, pictures[view], neighbour, raw[other], _TOLERANCE)
        for other, neighbour in zip(others, around)
    ]
    measured = without_speckles(np.any([check.agrees for check in checks], axis=0), own)
    inverse = fill(own.inverse, measured, own.step, pictures[view].image)
    return ViewDepth(np.clip(inverse, own.inverse.min(), own.inverse.max()), measured, own.step)
