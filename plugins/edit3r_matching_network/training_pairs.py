"""Pairs of views to learn from: kept small in memory once made, and augmented each time they are drawn."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import InputError
from edit3r.geometry.cameras import relative_to_first
from edit3r.interfaces import Dataset, SceneSample


@dataclass(frozen=True)
class TrainingPairs:
    """B pairs of images with all that is true about them; view 0 at the origin."""

    images: Float[Tensor, "batch 2 3 height width"]
    intrinsics: Float[Tensor, "batch 2 3 3"]
    c2w: Float[Tensor, "batch 2 4 4"]
    depths: Float[Tensor, "batch 2 height width"]

    def to(self, device: torch.device) -> "TrainingPairs":
        """Everything on another device."""
        return TrainingPairs(*(value.to(device) for value in vars(self).values()))


@dataclass(frozen=True)
class Augmentation:
    """How far a scene is changed each time it is drawn, beside mirroring, swapped views and colours; 0: not at all."""

    exposure: float = 0.25  # gain, bias and gamma of each view
    noise: float = 0.03  # most [sRGB]
    narrow: float = 0.3  # how often the images lose rows


class PairMemory:
    """Pairs of a dataset by index: 8-bit images, half-precision depths (41 kB a pair of 64 x 64 pixels)."""

    def __init__(self, data: Dataset) -> None:
        self._data = data
        self._kept: dict[int, TrainingPairs] = {}

    def __len__(self) -> int:
        return len(self._data)

    def batch(self, indices: Sequence[int]) -> TrainingPairs:
        """The pairs, not augmented. Raises InputError for data without depths or with fewer than two views."""
        return joined([self._pair(index) for index in indices])

    def _pair(self, index: int) -> TrainingPairs:
        if index not in self._kept:
            self._kept[index] = _packed(self._data[index])
        return _unpacked(self._kept[index])


def joined(pairs: Sequence[TrainingPairs]) -> TrainingPairs:
    """One batch of all pairs."""
    return TrainingPairs(*(torch.cat(values) for values in zip(*(vars(pair).values() for pair in pairs))))


def augmented(batch: TrainingPairs, how: Augmentation, rng: np.random.Generator) -> TrainingPairs:
    """Each scene changed in its own way; all lose the same rows, so that they still fit together."""
    singles = [TrainingPairs(*rows) for rows in zip(*(value.split(1) for value in vars(batch).values()))]
    changed = joined([_augmented(single, how, rng) for single in singles])
    return _fewer_rows(changed, rng) if rng.random() < how.narrow else changed


def _augmented(pair: TrainingPairs, how: Augmentation, rng: np.random.Generator) -> TrainingPairs:
    if rng.random() < 0.5:
        pair = _swapped(pair)
    if rng.random() < 0.5:
        pair = _mirrored(pair)
    images = pair.images[:, :, torch.from_numpy(rng.permutation(3))]
    gain, bias, gamma = (torch.from_numpy(rng.uniform(-1, 1, (1, 2, 1, 1, 1))).float() * how.exposure for _ in range(3))
    images = ((1 + 0.8 * gain) * images + 0.4 * bias).clamp(0, 1) ** gamma.exp()
    sigma = how.noise * rng.random() ** 2
    seed = torch.Generator().manual_seed(int(rng.integers(2**31)))
    images = images + sigma * torch.randn(images.shape, generator=seed)
    return replace(pair, images=images.clamp(0, 1))


def _swapped(pair: TrainingPairs) -> TrainingPairs:
    """View 1 becomes the reference."""
    c2w = relative_to_first(pair.c2w.flip(1))
    return TrainingPairs(pair.images.flip(1), pair.intrinsics.flip(1), c2w, pair.depths.flip(1))


def _mirrored(pair: TrainingPairs) -> TrainingPairs:
    """The scene in a mirror: x changes its sign in every camera."""
    sign = torch.diag(torch.tensor([-1.0, 1, 1, 1]))
    intrinsics = pair.intrinsics.clone()
    intrinsics[..., 0, 2] = 1 - intrinsics[..., 0, 2]
    return TrainingPairs(pair.images.flip(-1), intrinsics, sign @ pair.c2w @ sign, pair.depths.flip(-1))


def _fewer_rows(batch: TrainingPairs, rng: np.random.Generator) -> TrainingPairs:
    """Wider images: the middle five to seven eighths of the rows, in multiples of 8 pixels."""
    height = batch.images.shape[-2]
    kept = max(16, 8 * round(height * float(rng.uniform(0.6, 0.9)) / 8))
    top = (height - kept) // 2
    intrinsics = batch.intrinsics.clone()
    intrinsics[..., 1, 1] *= height / kept
    intrinsics[..., 1, 2] = (intrinsics[..., 1, 2] * height - top) / kept
    rows = slice(top, top + kept)
    return TrainingPairs(batch.images[..., rows, :], intrinsics, batch.c2w, batch.depths[..., rows, :])


def _packed(sample: SceneSample) -> TrainingPairs:
    if sample.context_depths is None or len(sample.context) < 2:
        raise InputError(
            f"scene {sample.name!r}: learning geometry takes two views with depths; use data that has them, "
            "such as procedural."
        )
    cameras = sample.context_cameras.select([0, 1])
    return TrainingPairs(
        (sample.context[None, :2] * 255).round().to(torch.uint8),
        cameras.intrinsics,
        cameras.c2w,
        sample.context_depths[None, :2].half(),
    )


def _unpacked(pair: TrainingPairs) -> TrainingPairs:
    return replace(pair, images=pair.images.float() / 255, depths=pair.depths.float())
