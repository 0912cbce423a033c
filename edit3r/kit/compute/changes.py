"""How much of a wished change of images was made, and how much was changed beside it.

A change is an edited image minus the unedited one [sRGB]. All arguments are tensors, or all are
NumPy arrays, of shapes that broadcast; weights are 1 where a value counts and 0 where it does not.
"""

from typing import TypeVar

import numpy as np
from torch import Tensor

__all__ = ["change_error", "change_uptake", "mean_change"]

Array = TypeVar("Array", Tensor, np.ndarray)


def change_uptake(shown: Array, wished: Array, weight: Array) -> float:
    """Return the share of the wished change that is shown: the projection of the one on the other.

    1: all of it; 0: none, something unrelated, or no instruction; below 0: the opposite.
    """
    energy = float((wished * wished * weight).sum())
    return float((shown * wished * weight).sum()) / energy if energy > 0 else 0.0


def change_error(shown: Array, wished: Array, weight: Array) -> float:
    """Return the mean absolute error of the shown change over the wished one's mean; or 0."""
    total = float((abs(wished) * weight).sum())
    return float((abs(shown - wished) * weight).sum()) / total if total > 0 else 0.0


def mean_change(shown: Array, weight: Array) -> float:
    """Return the mean absolute change [sRGB] over what counts, or 0; shapes are the same."""
    count = float(weight.sum())
    return float((abs(shown) * weight).sum()) / count if count > 0 else 0.0
