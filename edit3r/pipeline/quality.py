"""Measured settings of a run: what `--quality` and the budgets choose, and the file they are chosen
from.

A budget takes the most accurate measured point that fits it. A preset is one point; with a budget
that it does not fit, the most accurate point that fits and is no slower is taken. What is chosen
lies under everything else the user says. The points are in `edit3r/pipeline/presets/quality.yaml`,
measured as docs/tradeoff.md says.
"""

from collections.abc import Mapping, Sequence
from math import ceil
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from edit3r.config import Settings, make_settings, merge, read_yaml
from edit3r.errors import SettingsError
from edit3r.reporting import note

PRESETS = ("fast", "balanced", "best")  # quickest first

SHIPPED = Path(__file__).parent / "presets" / "quality.yaml"
_HEADER = "# Measured settings of a run, chosen by `--quality`; see docs/tradeoff.md for how they are written.\n"


class Expected(Settings):
    """What a point took and gave on one kind of scene."""

    seconds: float = Field(
        gt=0,
        description="all stages of a run without an editor, quickest repeats; mean of scenes",
    )
    seconds_first: float = Field(
        gt=0,
        description="first run of a process, as a run of the command is; mean of scenes",
    )
    memory_mb: float = Field(gt=0, description="peak of the process [MiB]")
    start_memory_mb: float = Field(
        ge=0, description="of which before anything was made [MiB]"
    )
    gaussians: int = Field(
        ge=0, description="largest number of Gaussians of the scenes"
    )
    psnr: float = Field(description="novel view [dB]")
    ssim: float = Field(description="novel view")


class ShippedPoint(Settings):
    """One measured point."""

    label: str
    preset: str | None = Field(None, description="fast, balanced or best")
    front: bool = Field(
        False,
        description="whether no other is as quick and as accurate, on every kind of scene",
    )
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

    measured: dict[str, Any] = Field(
        description="machine, threads, versions, clock, photos a scene and their size"
    )
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
    text = yaml.safe_dump(
        quality.model_dump(exclude_none=True), sort_keys=False, width=110
    )
    path.write_text(_HEADER + text, encoding="utf-8")
    return path


LIMITS = {
    "seconds": ("budget_ms", "ms", 1000),
    "gaussians": ("max_gaussians", "Gaussians", 1),
    "memory_mb": ("max_memory", "MiB", 1),
}
"""Cost to the setting that limits it, its unit there, and how many of those one unit of the cost
is.
"""


class Wish(Settings):
    """The four settings of a run that choose a measured point."""

    quality: Literal["fast", "balanced", "best"] | None = Field(
        None, description="preset"
    )
    budget_ms: float | None = Field(
        None, gt=0, description="most time a run may be expected to take [ms]"
    )
    max_gaussians: int | None = Field(
        None, ge=1, description="most Gaussians there may be"
    )
    max_memory: float | None = Field(
        None, gt=0, description="most memory the process may be expected to take [MiB]"
    )

    @property
    def is_made(self) -> bool:
        return bool(self.model_dump(exclude_none=True))

    @property
    def budgets(self) -> dict[str, float]:
        """Largest expectation of each kind of cost that still fits."""
        given = {
            cost: (getattr(self, name), scale)
            for cost, (name, _, scale) in LIMITS.items()
        }
        return {
            cost: most / scale
            for cost, (most, scale) in given.items()
            if most is not None
        }


def choose(
    wish: Wish, photos: int, quality: Quality | None = None
) -> tuple[ShippedPoint, dict[str, float]]:
    """The most accurate measured point that fits, and what it is expected to cost (see
    `expectation`).

    Time, Gaussians and memory beyond the program's own are taken to grow with the number of photos.
    Raises SettingsError, which says what the least is.
    """
    quality = quality or read_quality()
    if not quality.points:
        raise SettingsError(
            "--quality: nothing has been measured yet; see docs/tradeoff.md."
        )
    costs = [expectation(point, photos / quality.photos) for point in quality.points]
    limits = wish.budgets
    if wish.quality is not None:
        preset = next(
            (
                i
                for i, point in enumerate(quality.points)
                if point.preset == wish.quality
            ),
            None,
        )
        if preset is None:
            raise SettingsError(
                f"--quality {wish.quality}: no such preset was measured; see docs/tradeoff.md."
            )
        if best_within([costs[preset]], [0.0], limits) == 0:
            return quality.points[preset], costs[preset]
        limits["seconds"] = min(
            costs[preset]["seconds"], limits.get("seconds", float("inf"))
        )
    index = best_within(costs, [point.accuracy for point in quality.points], limits)
    if index is None:
        raise SettingsError(_nothing_fits(wish, costs, photos))
    return quality.points[index], costs[index]


def expectation(point: ShippedPoint, scale: float = 1.0) -> dict[str, float]:
    """Of the worse kind of scene, for `scale` times the photos it was measured with; the accuracy
    is not scaled.
    """
    scale, kinds = max(scale, 1.0), point.expected.values()
    return {
        "seconds": max(e.seconds_first for e in kinds) * scale,
        "seconds_when_warm": max(e.seconds for e in kinds) * scale,
        "gaussians": max(e.gaussians for e in kinds) * scale,
        "memory_mb": max(
            e.start_memory_mb + (e.memory_mb - e.start_memory_mb) * scale for e in kinds
        ),
        "psnr": min(e.psnr for e in kinds),
        "ssim": min(e.ssim for e in kinds),
    }


def _nothing_fits(wish: Wish, costs: list[dict[str, float]], photos: int) -> str:
    """One sentence: what was wished, and the least that was measured."""
    for cost, most in wish.budgets.items():
        least = min(expected[cost] for expected in costs)
        if least > most:
            name, unit, scale = LIMITS[cost]
            way_out = (
                f"; --gaussians {most:.0f} merges down to it, at an unmeasured loss"
                if cost == "gaussians"
                else ""
            )
            return (
                f"{_flag(name)} {most * scale:.0f}: too little for {photos} photos; "
                f"the least that was measured is {ceil(least * scale)} {unit}{way_out}."
            )
    wished = " ".join(
        f"{_flag(name)} {value}"
        for name, value in wish.model_dump(exclude_none=True).items()
    )
    return f"{wished}: no measured setting fits all of these at once for {photos} photos; relax one of them."


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def with_quality(settings: Mapping[str, Any], photos: int) -> dict[str, Any]:
    """Run settings, completed by the measured point that their quality or budgets choose."""
    wish = _wish_of(settings)
    if not wish.is_made:
        return dict(settings)
    point, _ = choose(wish, _used(settings, photos))
    return merge(
        {
            key: value
            for key, value in point.settings.items()
            if _fits(value, settings.get(key))
        },
        settings,
    )


def _fits(chosen: Any, given: Any) -> bool:
    """Whether a chosen setting may lie under a given one: settings of one component are of no use
    to another.
    """
    names = [
        value.get("name") if isinstance(value, Mapping) else value
        for value in (chosen, given)
    ]
    return None in names or names[0] == names[1]


def _wish_of(settings: Mapping[str, Any]) -> Wish:
    return make_settings(
        Wish,
        {key: settings[key] for key in Wish.model_fields if key in settings},
        where="run",
    )


def _used(settings: Mapping[str, Any], photos: int) -> int:
    """How many of the photos the run uses."""
    most = settings.get("views")
    return min(photos, most) if isinstance(most, int) else photos


def note_quality(config: Mapping[str, Any], photos: int) -> None:
    """Note for `run.json` which measured point the settings chose, its expected cost, and what
    differs from it.
    """
    wish = _wish_of(config)
    if not wish.is_made:
        return
    photos = _used(config, photos)
    point, expected = choose(wish, photos)
    facts = {
        "wish": wish.model_dump(exclude_none=True),
        "chosen": point.label,
        "preset": point.preset,
        "settings": point.settings,
        "overridden": [
            key
            for key, value in point.settings.items()
            if not _agrees(config.get(key), value)
        ],
        "expected": {key: round(value, 4) for key, value in expected.items()},
        "expected_for": f"a run without an editor on {photos} photos, on the worse of the "
        "measured kinds of scene",
        "measured": read_quality().measured,
    }
    note("quality", facts)


def _agrees(final: Any, chosen: Any) -> bool:
    """Whether everything that was chosen is so in the final settings, which may say more."""
    if isinstance(chosen, Mapping) and isinstance(final, Mapping):
        flat = {**final, **final.get("settings", {})}
        return all(_agrees(flat.get(key), value) for key, value in chosen.items())
    if isinstance(final, Mapping) and isinstance(chosen, str):
        return final.get("name") == chosen
    return final == chosen


def best_within(
    costs: Sequence[Mapping[str, float]],
    accuracies: Sequence[float],
    limits: Mapping[str, float],
) -> int | None:
    """Index of the most accurate point none of whose costs exceeds its limit, the first of equals;
    None: none fits.
    """
    fitting = [
        i
        for i, cost in enumerate(costs)
        if all(cost[key] <= most for key, most in limits.items())
    ]
    return max(fitting, key=lambda i: accuracies[i], default=None)
