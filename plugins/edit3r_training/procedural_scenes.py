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

TEXTURE_PHOTOS = """
astronaut brick camera cat coffee coins grass gravel hubble_deep_field immunohistochemistry logo
moon page retina rocket text
"""

Vectors = NDArray[np.float64]
Image = UInt8[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class ProceduralScene:
    """Objects in world coordinates around the origin (y down); object 0 is the room that encloses
    everything.

    An object is a unit sphere, cube [-1, 1]^3 or cylinder, moved by `local = world_to_local @ (x -
    centre)`.
    """

    kinds: NDArray[np.int64]  # [object] ELLIPSOID, BOX, CYLINDER or ROOM
    centres: Vectors  # [object, 3] [scene units]
    world_to_local: Vectors  # [object, 3, 3] inverse of rotation times half extents
    textures: NDArray[np.int64]  # [object, 6] of each face; round objects use the first
    repeats: Vectors  # [object] texture repeats over a face
    tints: Vectors  # [object, 6, 3] colour multipliers
    light: Vectors  # [3] unit vector to the light
    ambient: float  # share of the light that comes from everywhere, in [0, 1]

    @property
    def count(self) -> int:
        return len(self.kinds)

    def without(self, index: int) -> "ProceduralScene":
        """The scene with object `index` taken away."""
        return self._of(np.arange(self.count) != index)

    def first(self, count: int) -> "ProceduralScene":
        """The scene with only its first `count` objects."""
        return self._of(np.arange(self.count) < count)

    def _of(self, keep: NDArray[np.bool_]) -> "ProceduralScene":
        names = ("kinds", "centres", "world_to_local", "textures", "repeats", "tints")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


class _Object(NamedTuple):
    """One object; shapes and units as in `ProceduralScene`."""

    kind: int
    centre: Vectors
    size: Vectors  # half extents
    rotation: Vectors
    textures: NDArray[np.int64]
    repeats: float
    tints: Vectors


def random_scene(
    rng: np.random.Generator,
    objects: int,
    texture_count: int,
    avoid: Vectors,
    outdoor: bool,
) -> ProceduralScene:
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
    kinds, centres, sizes, rotations, textures, repeats, tints = map(
        np.array, zip(*placed)
    )
    world_to_local = (rotations / sizes[:, None]).swapaxes(1, 2)
    light = light / np.linalg.norm(light)
    ambient = float(rng.uniform(0.5, 0.85))
    return ProceduralScene(
        kinds, centres, world_to_local, textures, repeats, tints, light, ambient
    )


def _room(
    rng: np.random.Generator, texture_count: int, avoid: Vectors, outdoor: bool
) -> _Object:
    """The enclosing box; it holds all cameras."""
    reach = np.abs(avoid).max(0) + 0.3
    size = np.maximum(reach, rng.uniform([1.2, 0.8, 1.2], [2.5, 1.4, 2.5]))
    centre = np.zeros(3)
    if outdoor:
        size = np.maximum(reach, rng.uniform([6, 3, 6], [12, 6, 12]))
        # The ground just below the objects.
        centre[1] = rng.uniform(0.5, 0.9) - size[1]
        size[1] = max(size[1], reach[1] + abs(centre[1]))
        centre[1] = max(reach[1], 0.7) - size[1]
    textures = rng.integers(texture_count, size=6)
    tints = rng.uniform(0.6, 1.1, (6, 3))
    repeats = rng.uniform(1, 3) * (3 if outdoor else 1)
    return _Object(ROOM, centre, size, np.eye(3), textures, repeats, tints)


def _object(rng: np.random.Generator, texture_count: int, floor: float) -> _Object:
    """A random ellipsoid, box or cylinder, upright or tilted, often on the floor (its height)."""
    kind = int(rng.integers(3))
    size = rng.uniform(0.08, 0.36) * rng.uniform(0.5, 1.5, 3)
    if kind == BOX and rng.random() < 0.3:
        size[rng.integers(3)] *= 0.15  # a board
    standing = rng.random() < 0.7
    if standing:
        rotation = Rotation.from_euler("y", rng.uniform(0, 2 * np.pi))
    else:
        rotation = Rotation.random(random_state=rng)
    centre = rng.normal(size=3) * [0.75, 0.3, 0.75]
    if standing and rng.random() < 0.6:
        centre[1] = floor - size[1]
    tints = np.repeat(rng.uniform(0.5, 1.2, (1, 3)), 6, 0)
    textures = np.repeat(rng.integers(texture_count, size=1), 6)
    repeats = rng.uniform(0.5, 2)
    return _Object(kind, centre, size, rotation.as_matrix(), textures, repeats, tints)


def _is_clear(candidate: _Object, avoid: Vectors) -> bool:
    """Whether no camera position `avoid` [camera, 3] is inside or close to the object."""
    apart = np.linalg.norm(avoid - candidate.centre, axis=1)
    return bool((apart > 0.35 + np.linalg.norm(candidate.size)).all())


def look_at(position: Vectors, focus: Vectors, roll: float = 0.0) -> Vectors:
    """Camera-to-world 4x4 (OpenCV axes) at `position` towards `focus`, y down; `roll` [radians]."""
    forward = focus - position
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right = right / np.linalg.norm(right)
    down = np.cross(forward, right)
    c2w = np.eye(4)
    c2w[:3, 0] = np.cos(roll) * right + np.sin(roll) * down
    c2w[:3, 1] = np.cos(roll) * down - np.sin(roll) * right
    c2w[:3, 2] = forward
    c2w[:3, 3] = position
    return c2w


def random_cameras(
    rng: np.random.Generator, context: int, targets: int, angles: tuple[float, float]
) -> Float[np.ndarray, "view 4 4"]:
    """Poses of the context views, `angles` [degrees] apart, and then of the target views."""
    step = np.deg2rad(rng.uniform(*angles)) * rng.choice([-1, 1])
    start, elevation = rng.uniform(0, 2 * np.pi), rng.uniform(-0.05, 0.6)
    distance = rng.uniform(1.4, 2.4)
    focus = rng.normal(size=3) * 0.15
    between = rng.uniform(-0.15, context - 0.85, targets)
    poses = []
    for place in (*range(context), *between):
        azimuth = start + place * step
        height = elevation + rng.normal() * 0.25 * abs(step)
        radius = distance * (1 + 0.06 * rng.normal())
        across = np.cos(height)
        direction = across * np.sin(azimuth), -np.sin(height), -across * np.cos(azimuth)
        gaze = focus + rng.normal(size=3) * 0.08 * abs(step) * distance
        position = focus + radius * np.array(direction)
        poses.append(look_at(position, gaze, roll=rng.normal() * 0.04))
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


def _photos() -> list[Image]:
    """The packaged photos that textures are cut from."""
    from skimage import data

    photos = []
    for name in TEXTURE_PHOTOS.split():
        photo = np.atleast_3d(getattr(data, name)())[..., :3].astype(np.uint8)
        photos.append(np.broadcast_to(photo, (*photo.shape[:2], 3)))
    return photos


def _photo_crop(rng: np.random.Generator, photos: list[Image]) -> Image:
    """A random square of a random photo, mirrored and turned by chance."""
    photo = photos[rng.integers(len(photos))]
    side = max(int(rng.uniform(0.15, 0.8) * min(photo.shape[:2])), 24)
    y = rng.integers(photo.shape[0] - side + 1)
    x = rng.integers(photo.shape[1] - side + 1)
    crop = _shrunk(np.ascontiguousarray(photo[y : y + side, x : x + side]), TILE)
    if rng.random() < 0.5:
        crop = crop[:, ::-1]
    return np.rot90(crop, int(rng.integers(4))).copy()


def _pattern(rng: np.random.Generator) -> Image:
    """Plain colour, checks, stripes, dots or smooth noise between two or three random colours."""
    ys, xs = np.mgrid[:TILE, :TILE] / TILE
    waves = int(rng.integers(1, 9))
    kind = rng.integers(5)
    weight: np.ndarray
    if kind == 0:
        weight = np.zeros((TILE, TILE))
    elif kind == 1:
        weight = (np.floor(xs * 2 * waves) + np.floor(ys * 2 * waves)) % 2
    elif kind == 2:
        along = xs if rng.random() < 0.5 else xs + ys
        weight = 0.5 + 0.5 * np.sin(2 * np.pi * waves * along)
    elif kind == 3:
        radius = np.hypot(xs * waves % 1 - 0.5, ys * waves % 1 - 0.5)
        weight = radius < rng.uniform(0.2, 0.45)
    else:
        grid = rng.random((2 + waves, 2 + waves)).astype(np.float32)
        weight = cv2.resize(grid, (TILE, TILE), interpolation=cv2.INTER_CUBIC)
    first, second = rng.random((2, 3))
    noise = rng.normal(0, 0.02, (TILE, TILE, 1))
    colours = first + (second - first) * weight.clip(0, 1)[..., None] + noise
    return (colours.clip(0, 1) * 255).astype(np.uint8)


def _mip_levels(tile: Image) -> UInt8[np.ndarray, "level tile tile 3"]:
    """The texture at all sizes, each in the top-left corner of its level."""
    levels = np.zeros((LEVELS, TILE, TILE, 3), np.uint8)
    for level in range(LEVELS):
        side = TILE >> level
        levels[level, :side, :side] = _shrunk(tile, side)
    return levels


def _shrunk(image: Image, side: int) -> Image:
    return cv2.resize(image, (side, side), interpolation=cv2.INTER_AREA)
