"""Means over scenes, how sure they are, and which differences between methods count."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95
MIN_SCENES = 5  # with fewer there is no interval and no test


@dataclass(frozen=True)
class Interval:
    """A mean over scenes and where it lies with 95 % confidence."""

    mean: float
    scenes: int  # that had a value
    low: float | None = None  # None below MIN_SCENES
    high: float | None = None
    # of Student's two-sided test that the mean is 0
    p_value: float | None = None


def mean_over_scenes(values: Mapping[str, Sequence[float]]) -> Interval | None:
    """Return the mean over scenes of each scene's mean, with Student's t interval; NaN is left out.

    `values` are by scene; None when no scene has a value.
    """
    finite = [np.array(own)[np.isfinite(own)] for own in values.values()]
    means = [own.mean() for own in finite if len(own)]
    count = len(means)
    if count == 0:
        return None
    mean = float(np.mean(means))
    if count < MIN_SCENES:
        return Interval(mean, count)
    error = float(stats.sem(means))
    student = stats.t(count - 1)
    half = float(student.ppf((1 + CONFIDENCE) / 2)) * error
    if error > 0:
        p_value = 2 * float(student.sf(abs(mean) / error))
    else:
        p_value = float(mean == 0)
    return Interval(mean, count, mean - half, mean + half, p_value)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return the p values of a family of tests, corrected for their number (Holm 1979).

    Calling those below 0.05 different, a wrong call among all of them is made at most once in 20
    families.
    """
    order = np.argsort(p_values)
    count = len(order)
    stepped = np.asarray(p_values)[order] * np.arange(count, 0, -1)
    corrected = np.empty(count)
    corrected[order] = np.maximum.accumulate(stepped).clip(max=1)
    return corrected.tolist()
