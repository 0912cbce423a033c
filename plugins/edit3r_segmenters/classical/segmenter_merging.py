"""Merge superpixels into larger and larger regions; every region met on the way is a candidate object."""

import heapq
from dataclasses import dataclass

import numpy as np

from edit3r_segmenters.classical.segmenter_superpixels import Superpixels


@dataclass
class _Region:
    """One region while merging."""

    members: np.ndarray  # [N] bool, its superpixels
    area: float
    colour: np.ndarray  # [3], mean Lab
    histogram: np.ndarray  # [palette], pixels per palette colour
    neighbours: dict[int, tuple[float, float]]  # region: (border length, mean edge strength)


def merge_tree(superpixels: Superpixels) -> np.ndarray:
    """`[R, N]` bool: the members of every superpixel and of every merged region, cheapest merges first.

    The cost of a merge grows with the difference of colours, the edge between the two and the size of the smaller
    one, so that small or similar neighbours go first and objects survive as long as their outline is strong.
    """
    regions = _leaves(superpixels)
    found = [region.members for region in regions.values()]
    queue = [(_cost(regions, a, b), a, b) for a, b in map(tuple, superpixels.pairs.tolist())]
    heapq.heapify(queue)
    next_index = len(regions)
    while queue:
        _, a, b = heapq.heappop(queue)
        if a not in regions or b not in regions:
            continue
        regions[next_index] = _merged(regions, a, b)
        _reconnect(regions, a, b, next_index)
        found.append(regions[next_index].members)
        for other in regions[next_index].neighbours:
            heapq.heappush(queue, (_cost(regions, other, next_index), other, next_index))
        next_index += 1
    return np.stack(found)


def _leaves(superpixels: Superpixels) -> dict[int, _Region]:
    members = np.eye(len(superpixels.areas), dtype=bool)
    regions = {
        index: _Region(members[index], float(area), colour, histogram, {})
        for index, (area, colour, histogram) in enumerate(
            zip(superpixels.areas, superpixels.colours, superpixels.histograms)
        )
    }
    for (a, b), border, strength in zip(superpixels.pairs.tolist(), superpixels.borders, superpixels.strengths):
        regions[a].neighbours[b] = regions[b].neighbours[a] = (float(border), float(strength))
    return regions


def _cost(regions: dict[int, _Region], a: int, b: int) -> float:
    one, two = regions[a], regions[b]
    colour = float(np.linalg.norm(one.colour - two.colour)) / 25
    overlap = float(np.minimum(one.histogram / one.area, two.histogram / two.area).sum())
    _, strength = one.neighbours[b]
    return (colour + (1 - overlap) + strength) * min(one.area, two.area) ** 0.4


def _merged(regions: dict[int, _Region], a: int, b: int) -> _Region:
    one, two = regions[a], regions[b]
    area = one.area + two.area
    neighbours = {}
    for other in (one.neighbours.keys() | two.neighbours.keys()) - {a, b}:
        sides = [region.neighbours[other] for region in (one, two) if other in region.neighbours]
        border = sum(length for length, _ in sides)
        neighbours[other] = (border, sum(length * strength for length, strength in sides) / border)
    colour = (one.colour * one.area + two.colour * two.area) / area
    return _Region(one.members | two.members, area, colour, one.histogram + two.histogram, neighbours)


def _reconnect(regions: dict[int, _Region], a: int, b: int, merged: int) -> None:
    for other, edge in regions[merged].neighbours.items():
        regions[other].neighbours.pop(a, None)
        regions[other].neighbours.pop(b, None)
        regions[other].neighbours[merged] = edge
    del regions[a], regions[b]
