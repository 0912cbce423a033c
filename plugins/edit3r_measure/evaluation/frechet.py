"""Fréchet distance between two sets of features (Heusel et al. 2017): the mathematics of FID, on any features."""

import numpy as np
from jaxtyping import Float

__all__ = ["frechet_distance"]


def frechet_distance(first: Float[np.ndarray, "first feature"], second: Float[np.ndarray, "second feature"]) -> float:
    """|m1 - m2|^2 + tr(S1 + S2 - 2 (S1 S2)^(1/2)) of the sets' means and unbiased covariances, in float64.

    The trace of the root is the nuclear norm of the product of the centred sets, which needs no matrix of feature
    by feature and is exact when there are fewer pictures than features. Few pictures bias it upwards: compare only
    values of equal counts, and look at `kernel_distance` beside it. Raises ValueError below two rows.
    """
    a, b = (np.asarray(features, np.float64) for features in (first, second))
    if min(len(a), len(b)) < 2 or a.shape[1:] != b.shape[1:]:
        raise ValueError(f"expected two sets of at least 2 features of one width, got {a.shape} and {b.shape}")
    mean_a, mean_b = a.mean(0), b.mean(0)
    a, b = (a - mean_a) / np.sqrt(len(a) - 1), (b - mean_b) / np.sqrt(len(b) - 1)
    root = np.linalg.svd(a @ b.T, compute_uv=False).sum()
    distance = np.square(mean_a - mean_b).sum() + np.square(a).sum() + np.square(b).sum() - 2 * root
    return float(max(distance, 0.0))
