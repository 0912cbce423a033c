"""A random scene: a textured room or an open ground with many objects, as arrays the ray-caster reads."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

ELLIPSOID, BOX, CYLINDER, ROOM = 0, 1, 2, 3


@dataclass(frozen=True)
class Scene:
    """Objects in world coordinates around the origin (y down); object 0 is the room that encloses everything.

    An object is a unit sphere, cube [-1, 1]^3 or cylinder, moved by `local = world_to_local @ (x - centre)`.
    """

    kinds: NDArray[np.int64]  # [object] ELLIPSOID, BOX, CYLINDER or ROOM
    centres: NDArray[np.float64]  # [object, 3] [scene units]
    world_to_local: NDArray[np.float64]  # [object, 3, 3] inverse of rotation times half extents
    textures: NDArray[np.int64]  # [object, 6] texture of each face; round objects use the first
    repeats: NDArray[np.float64]  # [object] texture repeats over a face
    tints: NDArray[np.float64]  # [object, 6, 3] colour multipliers
    light: NDArray[np.float64]  # [3] unit vector to the light
    ambient: float  # share of the light that comes from everywhere, in [0, 1]

    @property
    def count(self) -> int:
        return len(self.kinds)

    def without(self, index: int) -> "Scene":
        """The scene with object `index` taken away."""
        keep = np.arange(self.count) != index
        return self._of(keep)

    def first(self, count: int) -> "Scene":
        """The scene with only its first `count` objects."""
        return self._of(np.arange(self.count) < count)

    def _of(self, keep: NDArray[np.bool_]) -> "Scene":
        names = ("kinds", "centres", "world_to_local", "textures", "repeats", "tints")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


def random_scene(
    rng: np.random.Generator, objects: int, texture_count: int, avoid: NDArray[np.float64], outdoor: bool
) -> Scene:
    """A scene whose `objects` stay clear of the camera positions `avoid` [camera, 3]."""
    room = _room(rng, texture_count, avoid, outdoor)
    placed = [room]
    for _ in range(20 * objects):
        if len(placed) > objects:
            break
        candidate = _object(rng, texture_count, floor=room[1][1] + room[2][1])
        if _is_clear(candidate, avoid):
            placed.append(candidate)
    kinds, centres, sizes, rotations, textures, repeats, tints = (list(column) for column in zip(*placed))
    inverse = np.stack([(rotation / size).T for rotation, size in zip(rotations, sizes)])
    light = rng.normal(size=3) * [1, 0.3, 1] + [0, -1.5, 0]
    return Scene(
        kinds=np.array(kinds, np.int64),
        centres=np.stack(centres),
        world_to_local=inverse,
        textures=np.stack(textures),
        repeats=np.array(repeats, np.float64),
        tints=np.stack(tints),
        light=light / np.linalg.norm(light),
        ambient=float(rng.uniform(0.5, 0.85)),
    )


def _room(rng: np.random.Generator, texture_count: int, avoid: NDArray[np.float64], outdoor: bool) -> tuple:
    """Kind, centre, half extents, rotation, textures, repeats, tints of the enclosing box; it holds all cameras."""
    reach = np.abs(avoid).max(0) + 0.3
    size = np.maximum(reach, rng.uniform([1.2, 0.8, 1.2], [2.5, 1.4, 2.5]))
    centre = np.zeros(3)
    if outdoor:
        size = np.maximum(reach, rng.uniform([6, 3, 6], [12, 6, 12]))
        centre[1] = rng.uniform(0.5, 0.9) - size[1]  # the ground just below the objects
        size[1] = max(size[1], reach[1] + abs(centre[1]))
        centre[1] = max(reach[1], 0.7) - size[1]
    textures = rng.integers(texture_count, size=6)
    tints = rng.uniform(0.6, 1.1, (6, 3))
    yaw = np.eye(3)
    return ROOM, centre, size, yaw, textures, rng.uniform(1, 3) * (3 if outdoor else 1), tints


def _object(rng: np.random.Generator, texture_count: int, floor: float) -> tuple:
    kind = int(rng.integers(3))
    size = rng.uniform(0.08, 0.36) * rng.uniform(0.5, 1.5, 3)
    if kind == BOX and rng.random() < 0.3:
        size[rng.integers(3)] *= 0.15  # a board
    standing = rng.random() < 0.7
    rotation = Rotation.from_euler("y", rng.uniform(0, 2 * np.pi)) if standing else Rotation.random(random_state=rng)
    centre = rng.normal(size=3) * [0.75, 0.3, 0.75]
    if standing and rng.random() < 0.6:
        centre[1] = floor - size[1]
    tints = np.repeat(rng.uniform(0.5, 1.2, (1, 3)), 6, 0)
    textures = np.repeat(rng.integers(texture_count, size=1), 6)
    return kind, centre, size, rotation.as_matrix(), textures, rng.uniform(0.5, 2), tints


def _is_clear(candidate: tuple, avoid: NDArray[np.float64]) -> bool:
    _, centre, size, *_ = candidate
    return bool((np.linalg.norm(avoid - centre, axis=1) > 0.35 + np.linalg.norm(size)).all())
