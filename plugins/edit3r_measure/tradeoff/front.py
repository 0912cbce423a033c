"""The names of the presets and the choice within limits, which belong to the core's `edit3r.quality`."""

from collections.abc import Mapping, Sequence

PRESETS = ("fast", "balanced", "best")
"""Quickest first."""


def best_within(
    costs: Sequence[Mapping[str, float]], accuracies: Sequence[float], limits: Mapping[str, float]
) -> int | None:
    """Return the index of the most accurate point none of whose costs exceeds its limit, the first of equals.

    None when no point fits.
    """
    fitting = [i for i, cost in enumerate(costs) if all(cost[key] <= most for key, most in limits.items())]
    return max(fitting, key=lambda i: accuracies[i], default=None)
