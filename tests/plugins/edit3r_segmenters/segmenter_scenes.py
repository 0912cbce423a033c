"""Drawn pictures with a known object, for the segmenter's tests."""

import cv2
import numpy as np
import torch


def noise(height: int, width: int, seed: int, cell: int = 6) -> np.ndarray:
    """Smooth texture, standard deviation about 1."""
    coarse = (
        np.random.default_rng(seed)
        .normal(size=(height // cell + 2, width // cell + 2))
        .astype(np.float32)
    )
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC) * 1.4


def backdrop(height: int = 120, width: int = 160, seed: int = 0) -> np.ndarray:
    """A greenish textured background, float32 [H, W, 3]."""
    texture = 0.07 * noise(height, width, seed) + 0.04 * noise(
        height, width, seed + 1, 2
    )
    return np.clip(np.array([0.35, 0.5, 0.35], np.float32) + texture[..., None], 0, 1)


def ellipse(
    height: int, width: int, centre: tuple[float, float], axes: tuple[float, float]
) -> np.ndarray:
    ys, xs = np.mgrid[:height, :width]
    return ((xs - centre[0]) / axes[0]) ** 2 + ((ys - centre[1]) / axes[1]) ** 2 <= 1


def with_object(
    picture: np.ndarray,
    mask: np.ndarray,
    colour=(0.85, 0.2, 0.15),
    seed: int = 9,
    offset: tuple[int, int] = (0, 0),
) -> np.ndarray:
    """`picture` with a textured object under `mask`; the texture moves with `offset` (x, y)."""
    height, width = mask.shape
    texture = np.roll(noise(height, width, seed, 4), (offset[1], offset[0]), (0, 1))
    surface = np.clip(np.array(colour, np.float32) + 0.08 * texture[..., None], 0, 1)
    return np.where(mask[..., None], surface, picture)


def tensor(picture: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1))).float()


def iou(one: torch.Tensor, other: np.ndarray) -> float:
    first, second = one.numpy() > 0.5, other > 0.5
    return float((first & second).sum() / max((first | second).sum(), 1))
