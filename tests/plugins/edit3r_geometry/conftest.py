"""A room with exact geometry, ray-cast: a leaning back wall, a floor and a box, all with rich
textures.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import pytest
import torch

from edit3r import Views

FOCAL = 0.9  # [picture widths]


@dataclass(frozen=True)
class Room:
    """Pictures of the room and all that is true about them."""

    views: Views
    c2w: np.ndarray  # [V, 4, 4], in the frame of view 0
    depths: np.ndarray  # [V, height, width] camera z


@dataclass(frozen=True)
class Rectangle:
    corner: np.ndarray
    right: np.ndarray
    down: np.ndarray
    texture: np.ndarray


def camera_at(x: float, y: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """Camera to world: moved by (x, y), turned by `turn` degrees about the vertical."""
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array([0, np.radians(turn), 0]))[0]
    matrix[:3, 3] = (x, y, 0)
    return matrix


def texture(seed: int) -> np.ndarray:
    """Noise of several sizes, `[512, 512, 3]` in [0, 1]."""
    random = np.random.default_rng(seed)
    layers = [
        cv2.resize(random.random((n, n, 3)), (512, 512), interpolation=cv2.INTER_CUBIC)
        for n in (8, 16, 32, 64)
    ]
    mixed = np.mean(layers, axis=0)
    return np.clip(0.5 + 2.2 * (mixed - mixed.mean()), 0, 1).astype(np.float32)


def rectangles(seed: int) -> list[Rectangle]:
    shapes = [
        # back wall, leaning away to the right
        ((-5, -3, 4.5), (10, 0, 1.0), (0, 4.2, 0)),
        ((-5, 1.2, 1.0), (10, 0, 0), (0, 0, 5.0)),  # floor
        ((-0.6, -0.3, 2.6), (1.1, 0, 0.2), (0, 1.5, 0)),  # front of the box
    ]
    return [
        Rectangle(*(np.array(v, float) for v in shape), texture(seed + i))
        for i, shape in enumerate(shapes)
    ]


def picture(
    c2w: np.ndarray, intrinsics: np.ndarray, size: tuple[int, int], seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """What a camera sees, antialiased by nine rays a pixel, and the depth along the middle ray."""
    sums = 0.0
    for dy in (-1 / 3, 0, 1 / 3):
        for dx in (-1 / 3, 0, 1 / 3):
            colours, depth = cast(c2w, intrinsics, size, (dx, dy), seed)
            sums = sums + colours
            if dx == dy == 0:
                middle = depth
    return sums / 9, middle


def cast(c2w, intrinsics, size, shift, seed) -> tuple[np.ndarray, np.ndarray]:
    height, width = size
    x, y = np.meshgrid(
        (np.arange(width) + 0.5 + shift[0]) / width,
        (np.arange(height) + 0.5 + shift[1]) / height,
    )
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(intrinsics).T
    directions, origin = rays @ c2w[:3, :3].T, c2w[:3, 3]
    nearest, colours = np.full(size, np.inf), np.zeros((*size, 3), np.float32)
    for shape in rectangles(seed):
        normal = np.cross(shape.right, shape.down)
        depth = ((shape.corner - origin) @ normal) / (directions @ normal)
        local = origin + directions * depth[..., None] - shape.corner
        u, v = (local @ axis / (axis @ axis) for axis in (shape.right, shape.down))
        hit = (depth > 0) & (depth < nearest)
        hit &= (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        places = ((511 * x).astype(np.float32) for x in (u, v))
        seen = cv2.remap(shape.texture, *places, cv2.INTER_LINEAR)
        nearest = np.where(hit, depth, nearest)
        colours = np.where(hit[..., None], seen, colours)
    return colours, nearest


@pytest.fixture(scope="session")
def make_room() -> Callable[..., Room]:
    """`make_room(places, size=(128, 160), focals=None, seed=0)`: the room seen from each (x, y,
    turn in degrees).
    """

    def make(
        places: Sequence[tuple[float, ...]],
        size=(128, 160),
        focals: Sequence[float] | None = None,
        seed: int = 0,
    ) -> Room:
        height, width = size
        cameras = [camera_at(*place) for place in places]
        focals = focals or [FOCAL] * len(cameras)
        intrinsics = np.array(
            [[[f, 0, 0.5], [0, f * width / height, 0.5], [0, 0, 1]] for f in focals]
        )
        seen = [picture(*one, size, seed) for one in zip(cameras, intrinsics)]
        images, depths = (np.stack(parts) for parts in zip(*seen))
        images = torch.from_numpy(images).permute(0, 3, 1, 2).float()[None]
        lenses = torch.from_numpy(intrinsics).float()[None]
        c2w = np.linalg.inv(cameras[0]) @ np.stack(cameras)
        return Room(Views(images.contiguous(), lenses), c2w, depths)

    return make


@pytest.fixture(scope="session")
def pair(make_room) -> Room:
    """Two views 5 degrees apart."""
    return make_room([(0,), (0.4, 0.05, -5)])
