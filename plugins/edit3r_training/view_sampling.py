"""Which photos of a sequence become context and target views."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ViewChoice:
    """Indices into a sequence of photos."""

    context: tuple[int, ...]
    target: tuple[int, ...]


def by_gap(rng: np.random.Generator, count: int, context: int, targets: int, gap: tuple[int, int]) -> ViewChoice | None:
    """Context views spread evenly over `gap` frames, targets uniform in between (ends included); None if too few."""
    most = min(gap[1], count - 1)
    least = max(min(gap[0], most), context - 1)
    if count < max(context, 2) or least > most:
        return None
    width = int(rng.integers(least, most + 1))
    first = int(rng.integers(count - width))
    chosen = np.linspace(first, first + width, context).round().astype(int)
    return ViewChoice(tuple(map(int, chosen)), tuple(map(int, rng.integers(first, first + width + 1, targets))))


def by_angle(
    rng: np.random.Generator, c2w: NDArray, context: int, targets: int, angles: tuple[float, float]
) -> ViewChoice | None:
    """Context views whose neighbours look `angles` [degrees] apart, targets near the middle; for unordered photos."""
    forward = c2w[:, :3, 2] / np.linalg.norm(c2w[:, :3, 2], axis=1, keepdims=True)
    apart = np.degrees(np.arccos(np.clip(forward @ forward.T, -1, 1)))
    for first in rng.permutation(len(c2w)):
        chosen = [int(first)]
        while len(chosen) < context:
            fit = (apart[chosen[-1]] >= angles[0]) & (apart[chosen[-1]] <= angles[1])
            fit[chosen] = False
            if not fit.any():
                break
            chosen.append(int(rng.choice(np.flatnonzero(fit))))
        if len(chosen) == context:
            return ViewChoice(tuple(chosen), _between(rng, c2w, chosen, targets))
    return None


def _between(rng: np.random.Generator, c2w: NDArray, context: list[int], targets: int) -> tuple[int, ...]:
    """The photos nearest to the middle of the context cameras, a few more than needed to choose from."""
    middle = c2w[context, :3, 3].mean(0)
    order = np.argsort(np.linalg.norm(c2w[:, :3, 3] - middle, axis=1), kind="stable")
    near = [int(i) for i in order if i not in context][: 2 * targets] or context
    return tuple(int(i) for i in rng.choice(near, targets, replace=len(near) < targets))
