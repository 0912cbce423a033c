"""What `--quality` and the budgets of a run stand for: a measured point, and what is expected of it.

A budget takes the most accurate measured point that fits it. A preset is that point itself; with a budget that it does
not fit, the most accurate one that fits and is no slower. What is chosen lies under everything else the user says.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil
from typing import Any, Literal

from edit3r_measure.tradeoff.front import best_within
from pydantic import Field

from edit3r.config import Settings, make_settings, merge
from edit3r.errors import SettingsError
from edit3r.quality_points import Quality, ShippedPoint, read_quality
from edit3r.reporting import note

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
        raise SettingsError("--quality: nothing has been measured yet; run edit3r tradeoff --update-presets.")
    costs = [expectation(point, photos / quality.photos) for point in quality.points]
    limits = _budgets(wish)
    preset = _preset(wish, quality)
    if preset is not None and best_within([costs[preset]], [0.0], limits) == 0:
        return Choice(quality.points[preset], costs[preset], quality.measured)
    if preset is not None:
        limits["seconds"] = min(costs[preset]["seconds"], limits.get("seconds", float("inf")))
    index = best_within(costs, [point.accuracy for point in quality.points], limits)
    if index is None:
        raise SettingsError(_impossible(wish, costs, photos))
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
        raise SettingsError(f"--quality {wish.quality}: no such preset was measured; see edit3r tradeoff.")
    return found[0]


def _budgets(wish: Wish) -> dict[str, float]:
    """Largest expectation of each kind that still fits."""
    milliseconds, gaussians, memory = wish.budget_ms, wish.max_gaussians, wish.max_memory
    seconds = None if milliseconds is None else milliseconds / 1000
    given = {"seconds": seconds, "gaussians": gaussians, "memory_mb": memory}
    return {key: value for key, value in given.items() if value is not None}


def _impossible(wish: Wish, costs: list[dict[str, float]], photos: int) -> str:
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


def under(settings: Mapping[str, Any], photos: int) -> dict[str, Any]:
    """Run settings with those that their wish stands for laid under them."""
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


def tell(config: Mapping[str, Any], photos: int) -> None:
    """Note for `run.json` what was chosen and expected, if anything was wished in a run's final settings."""
    if wish_of(config).is_made:
        note("quality", record(config, _used(config, photos)))


def _used(settings: Mapping[str, Any], photos: int) -> int:
    """How many of the photos the run uses."""
    most = settings.get("views")
    return min(photos, most) if isinstance(most, int) else photos


def record(config: Mapping[str, Any], photos: int) -> dict[str, Any]:
    """The choice behind the final settings of a run on `photos` photos, and where those differ from it."""
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
