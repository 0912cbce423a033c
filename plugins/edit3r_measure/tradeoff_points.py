"""From a sweep's raw measurements to points, the Pareto front, and the presets that `edit3r run
--quality` offers.

A point is one choice of run settings. A cost is smaller-is-better (seconds), an accuracy
larger-is-better (dB).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean, median
from typing import Any, NamedTuple

import numpy as np

from edit3r.io.decode import read_image
from edit3r.pipeline.quality import PRESETS, Expected, Quality, ShippedPoint
from edit3r_measure.metrics import psnr
from edit3r_measure.report import grouped
from edit3r_measure.tradeoff_knobs import SweepPlan

APART = 1.5
"""How many times as quick each preset is as the next, at least."""

DIGITS = {"psnr": 2, "ssim": 4, **dict.fromkeys(("seconds", "seconds_first"), 3)}
"""Digits after the point that presets are shipped with; other figures are whole numbers."""

Measurement = Mapping[str, Any]
"""One line of a sweep's `measurements.jsonl`."""


# Means over repeats and scenes.


class Spread(NamedTuple):
    """The smallest, the middle and the largest of some figures."""

    least: float
    middle: float
    most: float

    @staticmethod
    def of(values: Iterable[float]) -> "Spread":
        values = list(values)
        return Spread(min(values), median(values), max(values))

    @staticmethod
    def mean(spreads: Iterable["Spread"]) -> "Spread":
        """Return the mean of each of the three, for scenes that are measured one by one."""
        return Spread(*map(fmean, zip(*spreads)))


@dataclass(frozen=True)
class Figures:
    """A point on one kind of scene: means over its scenes unless said otherwise."""

    cpu: Spread  # all stages of one run [s]: over the repeats, then the mean over the scenes
    wall: Spread  # the same
    first: Mapping[
        str, float
    ]  # the first run of a process, by clock: what a run of the command takes [s]
    stages: Mapping[
        str, float
    ]  # processor seconds of each stage, median of the repeats
    memory_mb: float  # peak of the process, largest of the scenes [MiB]
    start_memory_mb: float  # of which the program took before it made anything
    gaussians: float
    most_gaussians: int  # largest of the scenes
    ply_mb: float  # [MB]
    psnr: float  # novel view [dB]
    psnr_of_scenes: Spread
    ssim: float
    perceptual: float | None
    uptake: float | None
    leak: float | None
    distance: float | None = (
        None  # PSNR of its novel views against those of the most accurate point [dB]
    )

    def seconds(self, clock: str) -> float:
        """Return the time to rank by, of "cpu" or "wall": the quickest repeats', which others
        disturbed least.
        """
        return getattr(self, clock).least


@dataclass(frozen=True)
class MeasuredPoint:
    """A point that every kind of scene was measured at."""

    label: str
    settings: Mapping[str, Any]
    kinds: Mapping[str, Figures]


def summarize(measurements: Sequence[Measurement]) -> list[MeasuredPoint]:
    """Return the points measured on every scene that any point was measured on, and that failed on
    none.
    """
    scenes = {m["scene"] for m in measurements}
    points = []
    for label, group in grouped(measurements, lambda m: m["label"]).items():
        if {m["scene"] for m in group} == scenes and not any(
            "failure" in m for m in group
        ):
            kinds = {
                kind: _figures(own)
                for kind, own in grouped(group, lambda m: m["kind"]).items()
            }
            points.append(MeasuredPoint(label, group[0]["settings"], kinds))
    return points


def with_distances(
    points: Sequence[MeasuredPoint],
    measurements: Sequence[Measurement],
    image: Callable[[str], Path],
) -> list[MeasuredPoint]:
    """Fill in `Figures.distance`; `image` is a measurement's key to the file of its novel view.

    The most accurate point of a kind of scene has none, nor has a point whose files are gone.
    """
    for kind in points[0].kinds if points else ():
        files = {
            (m["label"], m["scene"]): image(m["key"])
            for m in measurements
            if m["kind"] == kind
        }
        views = {
            at: np.asarray(read_image(f), np.float32) / 255
            for at, f in files.items()
            if f.is_file()
        }
        best = max(points, key=lambda point: point.kinds[kind].psnr).label
        filled = []
        for point in points:
            scenes = [
                scene
                for label, scene in views
                if label == point.label != best and (best, scene) in views
            ]
            decibels = [
                psnr(views[point.label, scene], views[best, scene]) for scene in scenes
            ]
            figures = replace(
                point.kinds[kind], distance=fmean(decibels) if decibels else None
            )
            filled.append(replace(point, kinds={**point.kinds, kind: figures}))
        points = filled
    return list(points)


def _figures(group: Sequence[Measurement]) -> Figures:
    runs = [[run for run in m["runs"] if not run["warm_up"]] for m in group]
    times = {
        clock: Spread.mean(
            Spread.of(sum(run[clock].values()) for run in scene) for scene in runs
        )
        for clock in ("cpu", "wall")
    }
    return Figures(
        **times,
        first={
            clock: fmean(sum(m["runs"][0][clock].values()) for m in group)
            for clock in times
        },
        stages=_stages(runs),
        memory_mb=max(m["memory_mb"] for m in group),
        start_memory_mb=min(m["start_memory_mb"] for m in group),
        most_gaussians=max(m["gaussians"] for m in group),
        ply_mb=fmean(m["ply_bytes"] for m in group) / 1e6,
        psnr_of_scenes=Spread.of(m["psnr"] for m in group),
        **{key: fmean(m[key] for m in group) for key in ("gaussians", "psnr", "ssim")},
        **{key: _mean_of_known(group, key) for key in ("perceptual", "uptake", "leak")},
    )


def _stages(runs: Sequence[Sequence[Mapping[str, Any]]]) -> dict[str, float]:
    """Return processor seconds by stage; component names in brackets are left out, so that points
    share the names.
    """
    names = dict.fromkeys(
        name for scene in runs for run in scene for name in run["cpu"]
    )
    found: dict[str, float] = {}
    for name in names:
        seconds = fmean(
            median(run["cpu"].get(name, 0.0) for run in scene) for scene in runs
        )
        plain = name.partition(" (")[0]
        found[plain] = found.get(plain, 0.0) + seconds
    return found


def _mean_of_known(group: Sequence[Measurement], key: str) -> float | None:
    values = [m[key] for m in group if m.get(key) is not None]
    return fmean(values) if values else None


# The front and the presets.


def front(costs: Sequence[float], accuracies: Sequence[float]) -> list[bool]:
    """Return for each point whether no other is at least as good in both and better in one (the
    Pareto front).

    Points equal in both do not push each other out.
    """
    points = list(zip(costs, accuracies))

    def beats(a: tuple[float, float], b: tuple[float, float]) -> bool:
        return a[0] <= b[0] and a[1] >= b[1] and a != b

    return [not any(beats(other, point) for other in points) for point in points]


def on_every_front(points: Sequence[ShippedPoint]) -> list[bool]:
    """Return for each point whether it is on the front of every kind of scene."""
    kinds = points[0].expected if points else ()
    fronts = [
        front(
            [p.expected[k].seconds for p in points],
            [p.expected[k].psnr for p in points],
        )
        for k in kinds
    ]
    return [all(flags) for flags in zip(*fronts)]


def choose_presets(
    points: Sequence[ShippedPoint], apart: float = 2.0
) -> dict[str, ShippedPoint]:
    """Return the presets by name, all of them points on every front; empty when there are no three
    such points.

    `best` is the most accurate point at the largest size of photos for which the other two exist.
    `balanced` is the most accurate point that costs at most 1/`apart` of it on every kind of scene,
    and `fast` the same below `balanced`.
    """
    candidates = [point for point, flag in zip(points, on_every_front(points)) if flag]
    largest = max((point.settings.get("size", 0) for point in points), default=0)
    full = [point for point in candidates if point.settings.get("size", 0) == largest]
    for best in sorted(full, key=lambda p: p.accuracy, reverse=True):
        balanced = _most_accurate(candidates, best, apart)
        fast = _most_accurate(candidates, balanced, apart) if balanced else None
        if fast is not None:
            return dict(zip(PRESETS, (fast, balanced, best)))
    return {}


def _most_accurate(
    points: Sequence[ShippedPoint], slower: ShippedPoint, apart: float
) -> ShippedPoint | None:
    """Return the most accurate point that costs at most 1/`apart` of `slower` on every kind of
    scene.
    """
    quick = [
        p
        for p in points
        if all(
            apart * p.expected[k].seconds <= e.seconds
            for k, e in slower.expected.items()
        )
    ]
    return max(quick, key=lambda p: p.accuracy, default=None)


def make_quality(
    points: Sequence[MeasuredPoint], measured: Mapping[str, Any], plan: SweepPlan
) -> Quality:
    """Return the content of the shipped file: all points, quickest first by `measured["clock"]`,
    with the presets.

    Only what `plan.shipped` names is a preset's business; a point that differs from the base
    elsewhere (in the number of photos, say) is measured but not shipped.
    """
    exact = []
    for point in points:
        shipped = {
            key: value for key, value in point.settings.items() if key in plan.shipped
        }
        if _of_the_user(point.settings, plan) == _of_the_user(plan.base, plan):
            expected = {
                kind: _expected(figures, measured["clock"])
                for kind, figures in point.kinds.items()
            }
            exact.append(
                ShippedPoint(label=point.label, settings=shipped, expected=expected)
            )
    presets = {
        point.label: preset for preset, point in choose_presets(exact, APART).items()
    }
    rounded = [
        point.model_copy(
            update={
                "front": flag,
                "preset": presets.get(point.label),
                "expected": {
                    kind: _rounded(expected)
                    for kind, expected in point.expected.items()
                },
            }
        )
        for point, flag in zip(exact, on_every_front(exact))
    ]
    return Quality(
        measured=dict(measured), points=sorted(rounded, key=lambda point: point.seconds)
    )


def _of_the_user(settings: Mapping[str, Any], plan: SweepPlan) -> dict[str, Any]:
    return {key: value for key, value in settings.items() if key not in plan.shipped}


def _expected(figures: Figures, clock: str) -> Expected:
    seconds: Spread = getattr(figures, clock)
    return Expected(
        seconds=seconds.least,
        seconds_first=figures.first[clock],
        memory_mb=figures.memory_mb,
        start_memory_mb=figures.start_memory_mb,
        gaussians=figures.most_gaussians,
        psnr=figures.psnr,
        ssim=figures.ssim,
    )


def _rounded(expected: Expected) -> Expected:
    return Expected(
        **{
            name: round(value, DIGITS.get(name, 0))
            for name, value in expected.model_dump().items()
        }
    )
