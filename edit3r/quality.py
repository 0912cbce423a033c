"""Measured settings of a run: what `--quality` and the budgets choose, and the file they are chosen from.

A budget takes the most accurate measured point that fits it. A preset is one point; with a budget that it does not fit,
the most accurate point that fits and is no slower is taken. What is chosen lies under everything else the user says.
The points are in `edit3r/presets/quality.yaml`, measured as docs/tradeoff.md says.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from edit3r.config import Settings, make_settings, merge, read_yaml
from edit3r.errors import SettingsError
from edit3r.reporting import note

PRESETS = ("fast", "balanced", "best")
"""The presets, quickest first."""

SHIPPED = Path(__file__).parent / "presets" / "quality.yaml"
_HEADER = "# Measured settings; docs/tradeoff.md says how.\n"


class Expected(Settings):
    """What a point took and gave on one kind of scene."""

    seconds: float = Field(gt=0, description="all stages of a run without an editor, quickest repeats; mean of scenes")
    seconds_first: float = Field(gt=0, description="first run of a process, as a run of the command is; mean of scenes")
    seconds_middle: float = Field(gt=0, description="middle of the repeats, mean over the scenes")
    seconds_most: float = Field(gt=0, description="slowest of the repeats, mean over the scenes")
    memory_mb: float = Field(gt=0, description="peak of the process [MiB]")
    start_memory_mb: float = Field(ge=0, description="of which before anything was made [MiB]")
    gaussians: int = Field(ge=0, description="largest number of Gaussians of the scenes")
    psnr: float = Field(description="novel view [dB]")
    ssim: float = Field(description="novel view")


class ShippedPoint(Settings):
    """One measured point."""

    label: str
    preset: str | None = Field(None, description="fast, balanced or best")
    front: bool = Field(False, description="whether no other is as quick and as accurate, on every kind of scene")
    settings: dict[str, Any] = Field(description="run settings")
    expected: dict[str, Expected] = Field(description="by kind of scene")

    @property
    def seconds(self) -> float:
        """On the slower kind of scene."""
        return max(e.seconds for e in self.expected.values())

    @property
    def accuracy(self) -> float:
        """PSNR [dB], mean over the kinds of scene."""
        return sum(e.psnr for e in self.expected.values()) / len(self.expected)


class Quality(Settings):
    """The content of the file of measured points."""

    measured: dict[str, Any] = Field(description="machine, threads, versions, clock, photos a scene and their size")
    points: list[ShippedPoint]

    @property
    def photos(self) -> int:
        """Photos a scene had when it was measured."""
        return self.measured.get("photos", 2)


def read_quality(path: Path | None = None) -> Quality:
    path = path or SHIPPED
    return make_settings(Quality, read_yaml(path), where=str(path))


def write_quality(quality: Quality, path: Path | None = None) -> Path:
    """Write the file that `edit3r run --quality` reads."""
    path = path or SHIPPED
    text = yaml.safe_dump(quality.model_dump(exclude_none=True), sort_keys=False, width=110)
    path.write_text(_HEADER + text, encoding="utf-8")
    return path


def preset_names(quality: Quality) -> list[str]:
    """The presets there are, quickest first."""
    return [name for name in PRESETS if any(point.preset == name for point in quality.points)]


_FLAGS = {
    "seconds": ("--budget-ms", "ms", 1000),
    "gaussians": ("--max-gaussians", "Gaussians", 1),
    "memory_mb": ("--max-memory", "MiB", 1),
}
"""Cost to the flag that limits it, its unit there, and how many of those one unit of the cost is."""


class Wish(Settings):
    """The four settings of a run that choose a measured point."""

    quality: Literal["fast", "balanced", "best"] | None = Field(
        None, description="preset: how accurate against how quick; see docs/tradeoff.md"
    )
    budget_ms: float | None = Field(None, gt=0, description="most time a run may be expected to take [ms]")
    max_gaussians: int | None = Field(None, ge=1, description="most Gaussians there may be")
    max_memory: float | None = Field(None, gt=0, description="most memory the process may be expected to take [MiB]")

    @property
    def is_made(self) -> bool:
        return any(value is not None for value in self.model_dump().values())


@dataclass(frozen=True)
class Choice:
    """The point that a wish stands for."""

    point: ShippedPoint
    expected: Mapping[str, float]  # seconds, memory_mb, gaussians, psnr, ssim: of the worse kind of scene
    measured: Mapping[str, Any]  # how

    @property
    def settings(self) -> dict[str, Any]:
        return self.point.settings


def choose(wish: Wish, photos: int, quality: Quality | None = None) -> Choice:
    """The most accurate measured point that fits; raises SettingsError saying what the least is.

    Time, Gaussians and memory beyond the program's own are taken to grow with the number of photos.
    """
    quality = quality or read_quality()
    if not quality.points:
        raise SettingsError("--quality: nothing has been measured yet; see docs/tradeoff.md.")
    costs = [expectation(point, photos / quality.photos) for point in quality.points]
    limits = _budgets(wish)
    preset = _preset(wish, quality)
    if preset is not None and best_within([costs[preset]], [0.0], limits) == 0:
        return Choice(quality.points[preset], costs[preset], quality.measured)
    if preset is not None:
        limits["seconds"] = min(costs[preset]["seconds"], limits.get("seconds", float("inf")))
    index = best_within(costs, [point.accuracy for point in quality.points], limits)
    if index is None:
        raise SettingsError(_nothing_fits(wish, costs, photos))
    return Choice(quality.points[index], costs[index], quality.measured)


def expectation(point: ShippedPoint, scale: float = 1.0) -> dict[str, float]:
    """Of the worse kind of scene, for `scale` times the photos it was measured with; the accuracy is not scaled."""
    scale, kinds = max(scale, 1.0), point.expected.values()
    return {
        "seconds": max(e.seconds_first for e in kinds) * scale,
        "seconds_when_warm": max(e.seconds for e in kinds) * scale,
        "gaussians": max(e.gaussians for e in kinds) * scale,
        "memory_mb": max(e.start_memory_mb + (e.memory_mb - e.start_memory_mb) * scale for e in kinds),
        "psnr": min(e.psnr for e in kinds),
        "ssim": min(e.ssim for e in kinds),
    }


def _preset(wish: Wish, quality: Quality) -> int | None:
    """Index of the preset that was wished."""
    if wish.quality is None:
        return None
    found = [index for index, point in enumerate(quality.points) if point.preset == wish.quality]
    if not found:
        raise SettingsError(f"--quality {wish.quality}: no such preset was measured; see docs/tradeoff.md.")
    return found[0]


def _budgets(wish: Wish) -> dict[str, float]:
    """Largest expectation of each kind that still fits."""
    milliseconds, gaussians, memory = wish.budget_ms, wish.max_gaussians, wish.max_memory
    seconds = None if milliseconds is None else milliseconds / 1000
    given = {"seconds": seconds, "gaussians": gaussians, "memory_mb": memory}
    return {key: value for key, value in given.items() if value is not None}


def _nothing_fits(wish: Wish, costs: list[dict[str, float]], photos: int) -> str:
    """One sentence: what was wished, and the least that was measured."""
    for key, most in _budgets(wish).items():
        least = min(cost[key] for cost in costs)
        if least > most:
            flag, unit, scale = _FLAGS[key]
            way_out = f"; --gaussians {most} merges down to it, at an unmeasured loss" if key == "gaussians" else ""
            return (
                f"{flag} {most * scale:.0f}: too little for {photos} photos; "
                f"the least that was measured is {ceil(least * scale)} {unit}{way_out}."
            )
    given = wish.model_dump(exclude_none=True).items()
    wished = " ".join(f"--{key.replace('_', '-')} {value}" for key, value in given)
    return f"{wished}: no measured setting fits all of these at once for {photos} photos; relax one of them."


def with_quality(settings: Mapping[str, Any], photos: int) -> dict[str, Any]:
    """Run settings, completed by the measured point that their quality or budgets choose."""
    wish = wish_of(settings)
    if not wish.is_made:
        return dict(settings)
    chosen = choose(wish, _used(settings, photos)).settings
    return merge({key: value for key, value in chosen.items() if _meant_for(value, settings.get(key))}, settings)


def _meant_for(chosen: Any, given: Any) -> bool:
    """Settings of one component are of no use to another that the user named."""
    names = [value if isinstance(value, str) else value.get("name") for value in (chosen, given) if _is_part(value)]
    return len(names) < 2 or names[0] == names[1] or None in names


def _is_part(value: Any) -> bool:
    return isinstance(value, str | Mapping)


def wish_of(settings: Mapping[str, Any]) -> Wish:
    return make_settings(Wish, {key: settings[key] for key in Wish.model_fields if key in settings}, where="run")


def note_quality(config: Mapping[str, Any], photos: int) -> None:
    """Note for `run.json` which measured point the settings chose, and what it was expected to cost."""
    if wish_of(config).is_made:
        note("quality", record(config, _used(config, photos)))


def _used(settings: Mapping[str, Any], photos: int) -> int:
    """How many of the photos the run uses."""
    most = settings.get("views")
    return min(photos, most) if isinstance(most, int) else photos


def record(config: Mapping[str, Any], photos: int) -> dict[str, Any]:
    """The point behind the final settings of a run on `photos` photos, and where the settings differ from it."""
    wish = wish_of(config)
    choice = choose(wish, photos)
    return {
        "wish": wish.model_dump(exclude_none=True),
        "chosen": choice.point.label,
        "preset": choice.point.preset,
        "settings": choice.settings,
        "overridden": [key for key, value in choice.settings.items() if not _agrees(config.get(key), value)],
        "expected": {key: round(value, 4) for key, value in choice.expected.items()},
        "expected_for": f"a run without an editor on {photos} photos, on the worse of the measured kinds of scene",
        "measured": dict(choice.measured),
    }


def _agrees(final: Any, chosen: Any) -> bool:
    """Whether everything that was chosen is so in the final settings, which may say more."""
    if isinstance(chosen, Mapping) and isinstance(final, Mapping):
        flat = {**final, **final.get("settings", {})}
        return all(_agrees(flat.get(key), value) for key, value in chosen.items())
    if isinstance(final, Mapping) and isinstance(chosen, str):
        return final.get("name") == chosen
    return final == chosen


def best_within(
    costs: Sequence[Mapping[str, float]], accuracies: Sequence[float], limits: Mapping[str, float]
) -> int | None:
    """Index of the most accurate point none of whose costs exceeds its limit, the first of equals; None: none fits."""
    fitting = [i for i, cost in enumerate(costs) if all(cost[key] <= most for key, most in limits.items())]
    return max(fitting, key=lambda i: accuracies[i], default=None)
