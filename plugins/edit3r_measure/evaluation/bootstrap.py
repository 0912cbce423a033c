"""How sure a mean over scenes is: a bootstrap that draws whole scenes, since edits of one scene resemble each other."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Interval", "bootstrap_mean"]

DRAWS = 2000
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Interval:
    """A mean and where it lies with 95 % confidence; low = high = mean for a single scene's worth of data."""

    mean: float
    low: float
    high: float
    scenes: int  # that had a value

    def __str__(self) -> str:
        return f"{self.mean:.3f} ({self.low:.3f} to {self.high:.3f})"


def bootstrap_mean(values: Mapping[str, Sequence[float]], seed: int = 0) -> Interval | None:
    """Mean over scenes of each scene's mean, with a percentile interval; `values` are by scene, NaN left out.

    None when no scene has a value.
    """
    finite = {scene: [v for v in of_scene if np.isfinite(v)] for scene, of_scene in values.items()}
    means = np.array([np.mean(of_scene) for of_scene in finite.values() if of_scene])
    if len(means) == 0:
        return None
    picks = np.random.default_rng(seed).integers(len(means), size=(DRAWS, len(means)))
    edge = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means[picks].mean(1), (edge, 1 - edge))
    return Interval(float(means.mean()), float(low), float(high), len(means))
