"""From raw measurements to one row a point and kind of scene, with the spread kept."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any

from edit3r_measure.tradeoff.front import Rated

Measurement = Mapping[str, Any]
"""One line of a sweep's `measurements.jsonl`."""


@dataclass(frozen=True)
class Spread:
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
        """Mean of each of the three, for scenes that are measured one by one."""
        return Spread(*(fmean(values) for values in zip(*((s.least, s.middle, s.most) for s in spreads))))


@dataclass(frozen=True)
class Figures:
    """A point on one kind of scene: means over its scenes unless said otherwise."""

    scenes: int
    cpu: Spread  # all stages of one run [s]: over the repeats, then the mean over the scenes
    wall: Spread  # the same
    first: Mapping[str, float]  # the first run of a process, by clock: what a run of the command takes [s]
    stages: Mapping[str, float]  # processor seconds of each stage, median of the repeats
    memory_mb: float  # peak of the process, largest of the scenes [MiB]
    start_memory_mb: float  # of which the program took before it made anything
    gaussians: float
    most_gaussians: float  # largest of the scenes
    ply_mb: float  # [MB]
    psnr: float  # novel view [dB]
    psnr_of_scenes: Spread
    ssim: float
    perceptual: float | None
    uptake: float | None
    leak: float | None
    repeatable: bool  # every repeat left the very same scene
    distance: float | None = None  # PSNR of its novel views against those of the most accurate point [dB]

    def seconds(self, clock: str) -> float:
        """The time to rank by, of "cpu" or "wall": that of the quickest repeats, which others disturbed least."""
        return getattr(self, clock).least


@dataclass(frozen=True)
class MeasuredPoint:
    """A point that every kind of scene was measured at."""

    label: str
    settings: Mapping[str, Any]
    kinds: Mapping[str, Figures]

    def rated(self, clock: str) -> Rated:
        """Cost by `clock` ("cpu" or "wall"), accuracy the novel views' PSNR."""
        costs = {kind: figures.seconds(clock) for kind, figures in self.kinds.items()}
        return Rated(self.label, costs, {kind: figures.psnr for kind, figures in self.kinds.items()})


def summarize(measurements: Sequence[Measurement]) -> list[MeasuredPoint]:
    """Points measured on every scene that any point was measured on, and that failed on none."""
    scenes = {m["scene"] for m in measurements}
    groups: dict[str, list[Measurement]] = {}
    for measurement in measurements:
        groups.setdefault(measurement["label"], []).append(measurement)
    return [
        MeasuredPoint(label, group[0]["settings"], {kind: _figures(part) for kind, part in _by_kind(group).items()})
        for label, group in groups.items()
        if {m["scene"] for m in group} == scenes and not any("failure" in m for m in group)
    ]


def _by_kind(group: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    kinds: dict[str, list[Measurement]] = {}
    for measurement in group:
        kinds.setdefault(measurement["kind"], []).append(measurement)
    return kinds


def _figures(group: Sequence[Measurement]) -> Figures:
    return Figures(
        scenes=len(group),
        cpu=Spread.mean(_times(m, "cpu") for m in group),
        wall=Spread.mean(_times(m, "wall") for m in group),
        first={clock: fmean(sum(m["runs"][0][clock].values()) for m in group) for clock in ("cpu", "wall")},
        stages=_stages(group),
        memory_mb=max(m["memory_mb"] for m in group),
        start_memory_mb=min(m["start_memory_mb"] for m in group),
        gaussians=fmean(m["gaussians"] for m in group),
        most_gaussians=max(m["gaussians"] for m in group),
        ply_mb=fmean(m["ply_bytes"] for m in group) / 1e6,
        psnr=fmean(m["psnr"] for m in group),
        psnr_of_scenes=Spread.of(m["psnr"] for m in group),
        ssim=fmean(m["ssim"] for m in group),
        perceptual=_mean(group, "perceptual"),
        uptake=_mean(group, "uptake"),
        leak=_mean(group, "leak"),
        repeatable=all(m["repeatable"] for m in group),
    )


def _counted(measurement: Measurement) -> list[Mapping[str, Any]]:
    return [run for run in measurement["runs"] if not run["warm_up"]]


def _times(measurement: Measurement, clock: str) -> Spread:
    """Of all stages together, over the repeats [s]."""
    return Spread.of(sum(run[clock].values()) for run in _counted(measurement))


def _stages(group: Sequence[Measurement]) -> dict[str, float]:
    """Stage to processor seconds; a component's name in brackets is left out, so that points share the names."""
    runs = [_counted(m) for m in group]
    names = dict.fromkeys(name for scene in runs for run in scene for name in run["cpu"])
    found: dict[str, float] = {}
    for name in names:
        seconds = fmean(median(run["cpu"].get(name, 0.0) for run in scene) for scene in runs)
        plain = name.partition(" (")[0]
        found[plain] = found.get(plain, 0.0) + seconds
    return found


def _mean(group: Sequence[Measurement], key: str) -> float | None:
    values = [m[key] for m in group if m.get(key) is not None]
    return fmean(values) if values else None
