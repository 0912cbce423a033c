"""Which measured points are worth having: the Pareto front, presets on it, and the best point within limits.

Pure functions of numbers. A cost is smaller-is-better (seconds), an accuracy larger-is-better (dB).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from edit3r.quality import PRESETS


@dataclass(frozen=True)
class Rated:
    """One point's cost and accuracy on every kind of scene; all points of a choice share the kinds."""

    name: str
    costs: Mapping[str, float]
    accuracies: Mapping[str, float]

    @property
    def accuracy(self) -> float:
        """Mean over the kinds of scene."""
        return sum(self.accuracies.values()) / len(self.accuracies)


def front(costs: Sequence[float], accuracies: Sequence[float]) -> list[bool]:
    """For each point, whether no other is at least as good in both and better in one.

    Points equal in both do not push each other out.
    """
    points = list(zip(costs, accuracies))
    return [not any(_beats(other, point) for other in points) for point in points]


def _beats(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[0] <= b[0] and a[1] >= b[1] and a != b


def on_every_front(points: Sequence[Rated]) -> list[bool]:
    """For each point, whether it is on the front of every kind of scene."""
    kinds = points[0].costs if points else ()
    fronts = [front([p.costs[k] for p in points], [p.accuracies[k] for p in points]) for k in kinds]
    return [all(flags) for flags in zip(*fronts)]


def choose_presets(points: Sequence[Rated], apart: float = 2.0) -> dict[str, Rated]:
    """The most accurate point on all fronts, and twice the most accurate one that is `apart` times as quick.

    On every kind of scene each preset costs at most 1/`apart` of the next one. Empty when there are no three such
    points: fewer would not be a choice.
    """
    candidates = [point for point, flag in zip(points, on_every_front(points)) if flag]
    for best in sorted(candidates, key=lambda p: p.accuracy, reverse=True):
        balanced = _most_accurate(candidates, best, apart)
        fast = _most_accurate(candidates, balanced, apart) if balanced else None
        if fast is not None:
            return dict(zip(PRESETS, (fast, balanced, best)))
    return {}


def _most_accurate(points: Sequence[Rated], slower: Rated, apart: float) -> Rated | None:
    quick = [p for p in points if all(apart * p.costs[kind] <= cost for kind, cost in slower.costs.items())]
    return max(quick, key=lambda p: p.accuracy, default=None)
