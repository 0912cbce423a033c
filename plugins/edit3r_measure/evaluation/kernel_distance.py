"""Kernel distance between two sets of features (Binkowski et al. 2018): the mathematics of KID, on any features."""

import numpy as np
from jaxtyping import Float

__all__ = ["kernel_distance"]

DEGREE, OFFSET = 3, 1.0


def kernel_distance(first: Float[np.ndarray, "first feature"], second: Float[np.ndarray, "second feature"]) -> float:
    """Unbiased squared maximum mean discrepancy under the kernel (x·y / features + 1)^3, in float64.

    All rows at once; tools that average over random subsets estimate the same number with more noise. Unbiased:
    equal distributions give about 0, also slightly below. Raises ValueError below two rows.
    """
    a, b = (np.asarray(features, np.float64) for features in (first, second))
    if min(len(a), len(b)) < 2 or a.shape[1:] != b.shape[1:]:
        raise ValueError(f"expected two sets of at least 2 features of one width, got {a.shape} and {b.shape}")
    return float(_mean_of_others(a) + _mean_of_others(b) - 2 * _kernel(a, b).mean())


def _kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a @ b.T / a.shape[1] + OFFSET) ** DEGREE


def _mean_of_others(features: np.ndarray) -> float:
    """Mean kernel of all pairs of different rows."""
    kernel = _kernel(features, features)
    return (kernel.sum() - np.trace(kernel)) / (len(features) * (len(features) - 1))
