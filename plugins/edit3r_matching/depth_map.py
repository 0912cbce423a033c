"""Raw depth of one picture from its neighbours: plane sweep, aggregation, best plane."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from edit3r_matching.camera import Picture
from edit3r_matching.plane_sweep import Neighbour, matching_cost, plane_inverse_depths
from edit3r_matching.semi_global import aggregate, best_plane

__all__ = ["RawDepth", "inverse_depth_range", "sweep_depth"]


@dataclass(frozen=True)
class RawDepth:
    """Inverse depth of every pixel before anything is checked."""

    inverse: np.ndarray  # [height, width] 1 / camera z, float32
    farthest: float  # inverse depth of the farthest plane of the sweep
    step: float  # inverse depth between two planes


def inverse_depth_range(depths: np.ndarray) -> tuple[float, float]:
    """Least and greatest inverse depth to search, from the `depths` of triangulated points.

    The outer 2 % may be wrong; beyond the rest there is room for what has no features, mostly in front of it.
    """
    least, greatest = np.percentile(1 / depths, [2, 98])
    room = 0.25 * (greatest - least)
    return max(least - room - 0.1 * least, 0.35 * least), greatest + room + 0.15 * greatest


def sweep_depth(
    reference: Picture, neighbours: Sequence[Neighbour], inverse_range: tuple[float, float], planes: int
) -> RawDepth:
    """Depth of `reference` from all `neighbours` together, with at most `planes` hypotheses."""
    inverse_depths = plane_inverse_depths(reference, neighbours, inverse_range, planes)
    position = best_plane(aggregate(matching_cost(reference, neighbours, inverse_depths), reference.grey))
    first, step = float(inverse_depths[0]), float(inverse_depths[1] - inverse_depths[0])
    return RawDepth((first + position * step).astype(np.float32), first, step)
