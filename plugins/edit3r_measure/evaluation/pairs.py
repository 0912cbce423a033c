"""Chooses pairs of photos to reconstruct from, and the photo between them to predict."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from edit3r.io.cameras import PosedCamera

__all__ = ["Triple", "choose_triples", "rotation_degrees"]


@dataclass(frozen=True)
class Triple:
    """Indices of two input photos and of the photo between them."""

    first: int
    second: int
    target: int
    degrees: float  # angle between the two input cameras


def rotation_degrees(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two rotation matrices [degrees], accurate for small angles."""
    return float(np.degrees(2 * np.arcsin(min(1.0, np.linalg.norm(a - b) / np.sqrt(8)))))


def choose_triples(
    cameras: Sequence[PosedCamera], count: int, degrees: tuple[float, float] = (5.0, 30.0)
) -> list[Triple]:
    """At most `count` triples, spread evenly over all pairs `degrees` apart which have a photo between them."""
    poses = [camera.c2w for camera in cameras]
    triples = []
    for first, second in combinations(range(len(poses)), 2):
        angle = rotation_degrees(poses[first][:3, :3], poses[second][:3, :3])
        if degrees[0] <= angle <= degrees[1]:
            target = _photo_between(poses, first, second, angle)
            if target is not None:
                triples.append(Triple(first, second, target, angle))
    chosen = np.unique(np.linspace(0, len(triples) - 1, min(count, len(triples))).round().astype(int))
    return [triples[index] for index in chosen]


def _photo_between(poses: Sequence[np.ndarray], first: int, second: int, angle: float) -> int | None:
    """The photo nearest to the middle of the baseline that looks the same way; None when there is none."""
    start, end = poses[first][:3, 3], poses[second][:3, 3]
    baseline = end - start
    best, best_distance = None, 0.4  # in baselines from the middle
    for index, pose in enumerate(poses):
        turns = (rotation_degrees(pose[:3, :3], poses[end][:3, :3]) for end in (first, second))
        if index in (first, second) or max(turns) > angle:
            continue
        distance = np.linalg.norm(pose[:3, 3] - (start + end) / 2) / max(np.linalg.norm(baseline), 1e-12)
        if distance < best_distance:
            best, best_distance = index, distance
    return best
