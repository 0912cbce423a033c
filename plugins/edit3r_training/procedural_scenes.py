"""Random scenes to train on: textured rooms or open grounds with many objects, the cameras that
look at them, textures.

Textures are crops of scikit-image's packaged photos and plain patterns. The motorcycle pair is left
out on purpose: it is the default demonstration and an evaluation scene.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

ELLIPSOID, BOX, CYLINDER, ROOM = 0, 1, 2, 3

TILE = 128
"""Side of a texture [texels]; level l has TILE >> l."""

LEVELS = 6

TEXTURE_PHOTOS = (
    "astronaut",
    "brick",
    "camera",
    "cat",
    "coffee",
    "coins",
    "grass",
    "gravel",
    "hubble_deep_field",
)
TEXTURE_PHOTOS += (
    "immunohistochemistry",
    "logo",
    "moon",
    "page",
    "retina",
    "rocket",
    "text",
)


@dataclass(frozen=True)
class Scene:
    """Objects in world coordinates around the origin (y down); object 0 is the room that encloses
    everything.

    An object is a unit sphere, cube [-1, 1]^3 or cylinder, moved by `local = world_to_local @ (x -
    centre)`.
    """

    kinds: NDArray[np.int64]  # [object] ELLIPSOID, BOX, CYLINDER or ROOM
    centres: NDArray[np.float64]  # [object, 3] [scene units]
    world_to_local: NDArray[
        np.float64
    ]  # [object, 3, 3] inverse of rotation times half extents
    textures: NDArray[
        np.int64
    ]  # [object, 6] texture of each face; round objects use the first
    repeats: NDArray[np.float64]  # [object] texture repeats over a face
    tints: NDArray[np.float64]  # [object, 6, 3] colour multipliers
    light: NDArray[np.float64]  # [3] unit vector to the light
    ambient: float  # share of the light that comes from everywhere, in [0, 1]

    @property
    def count(self) -> int:
        return len(self.kinds)

    def without(self, index: int) -> "Scene":
        """The scene with object `index` taken away."""
        return self._of(np.arange(self.count) != index)

    def first(self, count: int) -> "Scene":
        """The scene with only its first `count` objects."""
        return self._of(np.arange(self.count) < count)

    def _of(self, keep: NDArray[np.bool_]) -> "Scene":
        names = ("kinds", "centres", "world_to_local", "textures", "repeats", "tints")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


class _Object(NamedTuple):
    """One object; shapes and units as in `Scene`."""

    kind: int
    centre: NDArray[np.float64]
    size: NDArray[np.float64]  # half extents
    rotation: NDArray[np.float64]
    textures: NDArray[np.int64]
    repeats: float
    tints: NDArray[np.float64]


def random_scene(
    rng: np.random.Generator,
    objects: int,
    texture_count: int,
    avoid: NDArray[np.float64],
    outdoor: bool,
) -> Scene:
    """A scene whose `objects` stay clear of the camera positions `avoid` [camera, 3]."""
    room = _room(rng, texture_count, avoid, outdoor)
    placed = [room]
    for _ in range(20 * objects):
        if len(placed) > objects:
            break
        candidate = _object(rng, texture_count, floor=room.centre[1] + room.size[1])
        if _is_clear(candidate, avoid):
            placed.append(candidate)
    light = rng.normal(size=3) * [1, 0.3, 1] + [0, -1.5, 0]
    return Scene(
        kinds=np.array([one.kind for one in placed], np.int64),
        centres=np.stack([one.centre for one in placed]),
        world_to_local=np.stack([(one.rotation / one.size).T for one in placed]),
        textures=np.stack([one.textures for one in placed]),
        repeats=np.array([one.repeats for one in placed], np.float64),
        tints=np.stack([one.tints for one in placed]),
        light=light / np.linalg.norm(light),
        ambient=float(rng.uniform(0.5, 0.85)),
    )


def _room(
    rng: np.random.Generator,
    texture_count: int,
    avoid: NDArray[np.float64],
    outdoor: bool,
) -> _Object:
    """The enclosing box; it holds all cameras."""
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
    return _Object(
        ROOM,
        centre,
        size,
        np.eye(3),
        textures,
        rng.uniform(1, 3) * (3 if outdoor else 1),
        tints,
    )


def _object(rng: np.random.Generator, texture_count: int, floor: float) -> _Object:
    """A random ellipsoid, box or cylinder, upright or tilted, often standing on the floor (height
    `floor`).
    """
    kind = int(rng.integers(3))
    size = rng.uniform(0.08, 0.36) * rng.uniform(0.5, 1.5, 3)
    if kind == BOX and rng.random() < 0.3:
        size[rng.integers(3)] *= 0.15  # a board
    standing = rng.random() < 0.7
    rotation = (
        Rotation.from_euler("y", rng.uniform(0, 2 * np.pi))
        if standing
        else Rotation.random(random_state=rng)
    )
    centre = rng.normal(size=3) * [0.75, 0.3, 0.75]
    if standing and rng.random() < 0.6:
        centre[1] = floor - size[1]
    tints = np.repeat(rng.uniform(0.5, 1.2, (1, 3)), 6, 0)
    textures = np.repeat(rng.integers(texture_count, size=1), 6)
    return _Object(
        kind, centre, size, rotation.as_matrix(), textures, rng.uniform(0.5, 2), tints
    )


def _is_clear(candidate: _Object, avoid: NDArray[np.float64]) -> bool:
    """Whether no camera position `avoid` [camera, 3] is inside or close to the object."""
    apart = np.linalg.norm(avoid - candidate.centre, axis=1)
    return bool((apart > 0.35 + np.linalg.norm(candidate.size)).all())


def look_at(
    position: NDArray[np.float64], focus: NDArray[np.float64], roll: float = 0.0
) -> NDArray[np.float64]:
    """Camera-to-world 4x4 (OpenCV axes) at `position` looking at `focus`, world y down; `roll`
    [radians].
    """
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
) -> Float[np.ndarray, "view 4 4"]:
    """Poses of the context views, `angles` [degrees] from one to the next, and then of the target
    views.
    """
    step = np.deg2rad(rng.uniform(*angles)) * rng.choice([-1, 1])
    start, elevation, distance = (
        rng.uniform(0, 2 * np.pi),
        rng.uniform(-0.05, 0.6),
        rng.uniform(1.4, 2.4),
    )
    focus = rng.normal(size=3) * 0.15
    at = np.concatenate(
        (np.arange(context), rng.uniform(-0.15, context - 0.85, targets))
    )
    poses = []
    for place in at:
        azimuth = start + place * step
        height = elevation + rng.normal() * 0.25 * abs(step)
        radius = distance * (1 + 0.06 * rng.normal())
        direction = [
            np.cos(height) * np.sin(azimuth),
            -np.sin(height),
            -np.cos(height) * np.cos(azimuth),
        ]
        gaze = focus + rng.normal(size=3) * 0.08 * abs(step) * distance
        poses.append(
            look_at(
                focus + radius * np.array(direction), gaze, roll=rng.normal() * 0.04
            )
        )
    return np.stack(poses)


@cache
def texture_bank(
    count: int = 96, photo_share: float = 0.6, seed: int = 0
) -> UInt8[np.ndarray, "texture level tile tile 3"]:
    """Random textures with mip levels; level l fills the top-left (TILE >> l) square."""
    rng = np.random.default_rng(seed)
    photos = _photos()
    bank = np.zeros((count, LEVELS, TILE, TILE, 3), np.uint8)
    for index in range(count):
        tile = _photo_crop(rng, photos) if rng.random() < photo_share else _pattern(rng)
        bank[index] = _mip_levels(tile)
    return bank


def _photos() -> list[UInt8[np.ndarray, "height width 3"]]:
    """The packaged photos that textures are cut from."""
    from skimage import data

    photos = []
    for name in TEXTURE_PHOTOS:
        photo = np.asarray(getattr(data, name)())
        photo = (
            np.repeat(photo[..., None], 3, -1) if photo.ndim == 2 else photo[..., :3]
        )
        photos.append(photo.astype(np.uint8))
    return photos


def _photo_crop(
    rng: np.random.Generator, photos: list[UInt8[np.ndarray, "_ _ 3"]]
) -> UInt8[np.ndarray, "tile tile 3"]:
    """A random square of a random photo, mirrored and turned by chance."""
    photo = photos[rng.integers(len(photos))]
    side = int(rng.uniform(0.15, 0.8) * min(photo.shape[:2]))
    side = max(side, 24)
    y = rng.integers(photo.shape[0] - side + 1)
    x = rng.integers(photo.shape[1] - side + 1)
    crop = cv2.resize(
        photo[y : y + side, x : x + side], (TILE, TILE), interpolation=cv2.INTER_AREA
    )
    if rng.random() < 0.5:
        crop = crop[:, ::-1]
    return np.rot90(crop, rng.integers(4)).copy()


def _pattern(rng: np.random.Generator) -> UInt8[np.ndarray, "tile tile 3"]:
    """Plain colour, checks, stripes, dots or smooth noise between two or three random colours."""
    ys, xs = np.mgrid[:TILE, :TILE] / TILE
    waves = int(rng.integers(1, 9))
    kind = rng.integers(5)
    if kind == 0:
        weight = np.zeros((TILE, TILE))
    elif kind == 1:
        weight = ((np.floor(xs * 2 * waves) + np.floor(ys * 2 * waves)) % 2).astype(
            float
        )
    elif kind == 2:
        weight = 0.5 + 0.5 * np.sin(
            2 * np.pi * waves * (xs if rng.random() < 0.5 else xs + ys)
        )
    elif kind == 3:
        weight = (
            np.hypot(xs * waves % 1 - 0.5, ys * waves % 1 - 0.5)
            < rng.uniform(0.2, 0.45)
        ).astype(float)
    else:
        grid = rng.random((2 + waves, 2 + waves)).astype(np.float32)
        weight = cv2.resize(grid, (TILE, TILE), interpolation=cv2.INTER_CUBIC).clip(
            0, 1
        )
    first, second = rng.random((2, 3))
    colours = (
        first
        + (second - first) * weight[..., None]
        + rng.normal(0, 0.02, (TILE, TILE, 1))
    )
    return (colours.clip(0, 1) * 255).astype(np.uint8)


def _mip_levels(
    tile: UInt8[np.ndarray, "tile tile 3"],
) -> UInt8[np.ndarray, "level tile tile 3"]:
    """The texture at all sizes, each in the top-left corner of its level."""
    levels = np.zeros((LEVELS, TILE, TILE, 3), np.uint8)
    for level in range(LEVELS):
        side = TILE >> level
        levels[level, :side, :side] = cv2.resize(
            tile, (side, side), interpolation=cv2.INTER_AREA
        )
    return levels
