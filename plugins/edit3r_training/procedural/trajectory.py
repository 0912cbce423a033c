"""Camera placement: context views a given angle apart around a point of interest, target views between them."""

import numpy as np
from numpy.typing import NDArray


def look_at(position: NDArray[np.float64], focus: NDArray[np.float64], roll: float = 0.0) -> NDArray[np.float64]:
    """Camera-to-world 4x4 (OpenCV axes) at `position` looking at `focus`, world y down; `roll` [radians]."""
    forward = focus - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    c2w = np.eye(4)
    c2w[:3, 0] = np.cos(roll) * right + np.sin(roll) * down
    c2w[:3, 1] = np.cos(roll) * down - np.sin(roll) * right
    c2w[:3, 2], c2w[:3, 3] = forward, position
    return c2w


def random_cameras(
    rng: np.random.Generator, context: int, targets: int, angles: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Context and target poses `[view, 4, 4]`; neighbouring context views are `angles` [degrees] apart."""
    step = np.deg2rad(rng.uniform(*angles)) * rng.choice([-1, 1])
    start, elevation, distance = rng.uniform(0, 2 * np.pi), rng.uniform(-0.05, 0.6), rng.uniform(1.4, 2.4)
    focus = rng.normal(size=3) * 0.15
    at = np.concatenate((np.arange(context), rng.uniform(-0.15, context - 0.85, targets)))
    poses = []
    for place in at:
        azimuth = start + place * step
        height = elevation + rng.normal() * 0.25 * abs(step)
        radius = distance * (1 + 0.06 * rng.normal())
        direction = [np.cos(height) * np.sin(azimuth), -np.sin(height), -np.cos(height) * np.cos(azimuth)]
        gaze = focus + rng.normal(size=3) * 0.08 * abs(step) * distance
        poses.append(look_at(focus + radius * np.array(direction), gaze, roll=rng.normal() * 0.04))
    poses = np.stack(poses)
    return poses[:context], poses[context:]
