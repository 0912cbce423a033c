"""Learning rate and data order as pure functions of the step, so that resuming needs no state of
theirs.
"""

import math
import random

import numpy as np
import torch


def warmup_cosine(step: int, steps: int, warmup: int, floor: float = 0.05) -> float:
    """Factor of the learning rate: linear over `warmup` steps, then a cosine to `floor`."""
    if step < warmup:
        return (step + 1) / warmup
    way = min(1.0, (step - warmup) / max(1, steps - warmup))
    return floor + (1 - floor) * 0.5 * (1 + math.cos(math.pi * way))


def batch_indices(
    step: int, batch: int, length: int, seed: int, rank: int = 0, world: int = 1
) -> list[int]:
    """Indices of one step on process `rank`: every epoch a new permutation, each once."""
    first = (step * world + rank) * batch
    return [
        _shuffled(position, length, seed) for position in range(first, first + batch)
    ]


def step_generator(seed: int, step: int, slot: int) -> np.random.Generator:
    """The random numbers of one sample of one step: nothing to save, nothing to restore."""
    return np.random.default_rng((seed, step, slot))


def seed_everything(*numbers: int) -> None:
    """Start the generators of torch, numpy and Python from these numbers, for whoever uses them."""
    seed = int(np.random.SeedSequence(numbers).generate_state(1)[0])
    random.seed(seed)
    np.random.seed(seed)
    torch.manual_seed(seed)


def _shuffled(position: int, length: int, seed: int) -> int:
    """Entry `position % length` of the epoch's permutation, an affine map with a coprime step."""
    epoch, place = divmod(position, length)
    rng = np.random.default_rng((seed, epoch, length))
    stride = int(rng.integers(1, length + 1))
    while math.gcd(stride, length) != 1:
        stride += 1
    return (int(rng.integers(length)) + stride * place) % length
