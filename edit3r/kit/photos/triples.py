"""Pairs of posed photos with a third between them, to compare a new view with."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import torch
from jaxtyping import Float

from edit3r.kit.geometry.rotations import rotation_angle
from edit3r.kit.photos.images import evenly

Pose = Float[np.ndarray, "4 4"]  # camera to world

# How far a photo between two others may be from the middle [baselines]; no figure kept
MAX_OFF_MIDDLE = 0.4


def rotation_degrees(a: Float[np.ndarray, "n n"], b: Float[np.ndarray, "n n"]) -> float:
    """Return the angle between two rotations or poses [degrees], accurate for small angles."""
    rotations = (torch.from_numpy(matrix[:3, :3]) for matrix in (a, b))
    return float(torch.rad2deg(rotation_angle(*rotations)))


def choose_triples(
    poses: Sequence[Pose], count: int, degrees: tuple[float, float] = (5.0, 30.0)
) -> list[tuple[int, int, int]]:
    """Return at most `count` triples (first, second, a photo between them), spread evenly over all
    pairs that are `degrees` apart.
    """
    triples = []
    for first, second in combinations(range(len(poses)), 2):
        if degrees[0] <= rotation_degrees(poses[first], poses[second]) <= degrees[1]:
            for target in photos_between(poses, first, second)[:1]:
                triples.append((first, second, target))
    return evenly(triples, count)


def photos_between(poses: Sequence[Pose], first: int, second: int) -> list[int]:
    """Return the photos near the baseline's middle that look the same way, nearest to it first."""
    ends = [poses[first], poses[second]]
    angle = rotation_degrees(*ends)
    start, end = (pose[:3, 3] for pose in ends)
    limit = MAX_OFF_MIDDLE * max(float(np.linalg.norm(end - start)), 1e-12)
    distances = {}
    for index, pose in enumerate(poses):
        turn = max(rotation_degrees(pose, other) for other in ends)
        distance = np.linalg.norm(pose[:3, 3] - (start + end) / 2)
        if index not in (first, second) and turn <= angle and distance < limit:
            distances[index] = distance
    return sorted(distances, key=distances.__getitem__)
