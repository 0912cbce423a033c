"""The texture bank: crops of scikit-image's packaged photos and plain patterns, with mip levels.

The motorcycle pair is left out on purpose: it is the default demonstration and an evaluation scene.
"""

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

TILE = 128
"""Side of a texture [texels]; level l has TILE >> l."""

LEVELS = 6

PHOTOS = [
    "astronaut",
    "brick",
    "camera",
    "cat",
    "coffee",
    "coins",
    "grass",
    "gravel",
    "hubble_deep_field",
    "immunohistochemistry",
    "logo",
    "moon",
    "page",
    "retina",
    "rocket",
    "text",
]


@cache
def texture_bank(count: int = 96, photo_share: float = 0.6, seed: int = 0) -> NDArray[np.uint8]:
    """`[count, LEVELS, TILE, TILE, 3]` textures; level l fills the top-left (TILE >> l) square."""
    rng = np.random.default_rng(seed)
    photos = _photos()
    bank = np.zeros((count, LEVELS, TILE, TILE, 3), np.uint8)
    for index in range(count):
        tile = _photo_crop(rng, photos) if rng.random() < photo_share else _pattern(rng)
        bank[index] = _mip_levels(tile)
    return bank


def _photos() -> list[NDArray[np.uint8]]:
    from skimage import data

    photos = []
    for name in PHOTOS:
        photo = np.asarray(getattr(data, name)())
        photo = np.repeat(photo[..., None], 3, -1) if photo.ndim == 2 else photo[..., :3]
        photos.append(photo.astype(np.uint8))
    return photos


def _photo_crop(rng: np.random.Generator, photos: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    photo = photos[rng.integers(len(photos))]
    side = int(rng.uniform(0.15, 0.8) * min(photo.shape[:2]))
    side = max(side, 24)
    y = rng.integers(photo.shape[0] - side + 1)
    x = rng.integers(photo.shape[1] - side + 1)
    crop = cv2.resize(photo[y : y + side, x : x + side], (TILE, TILE), interpolation=cv2.INTER_AREA)
    if rng.random() < 0.5:
        crop = crop[:, ::-1]
    return np.rot90(crop, rng.integers(4)).copy()


def _pattern(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Plain colour, checks, stripes, dots or smooth noise between two or three random colours."""
    ys, xs = np.mgrid[:TILE, :TILE] / TILE
    waves = int(rng.integers(1, 9))
    kind = rng.integers(5)
    if kind == 0:
        weight = np.zeros((TILE, TILE))
    elif kind == 1:
        weight = ((np.floor(xs * 2 * waves) + np.floor(ys * 2 * waves)) % 2).astype(float)
    elif kind == 2:
        weight = 0.5 + 0.5 * np.sin(2 * np.pi * waves * (xs if rng.random() < 0.5 else xs + ys))
    elif kind == 3:
        weight = (np.hypot(xs * waves % 1 - 0.5, ys * waves % 1 - 0.5) < rng.uniform(0.2, 0.45)).astype(float)
    else:
        grid = rng.random((2 + waves, 2 + waves)).astype(np.float32)
        weight = cv2.resize(grid, (TILE, TILE), interpolation=cv2.INTER_CUBIC).clip(0, 1)
    first, second = rng.random((2, 3))
    colours = first + (second - first) * weight[..., None] + rng.normal(0, 0.02, (TILE, TILE, 1))
    return (colours.clip(0, 1) * 255).astype(np.uint8)


def _mip_levels(tile: NDArray[np.uint8]) -> NDArray[np.uint8]:
    levels = np.zeros((LEVELS, TILE, TILE, 3), np.uint8)
    for level in range(LEVELS):
        side = TILE >> level
        levels[level, :side, :side] = cv2.resize(tile, (side, side), interpolation=cv2.INTER_AREA)
    return levels
