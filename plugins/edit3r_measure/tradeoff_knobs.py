"""What `edit3r tradeoff` sweeps: named knobs, each with named values, and the points that they
make.

A value is a layer of run settings (as in `edit3r run --config`). A point is the base with some
values laid over it.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import Field

from edit3r.config import Settings, make_settings, merge, read_yaml
from edit3r.errors import SettingsError, suggest

SHIPPED = Path(__file__).with_name("tradeoff_knobs.yaml")
BASE = "base"
"""Label of the point without any value laid over it."""


class Knob(Settings):
    """One thing to turn."""

    about: str = Field(description="what it is, with its unit")
    values: dict[str, dict[str, Any]] = Field(
        description="name of each value to the run settings it stands for"
    )


class SweepPlan(Settings):
    """A knobs file."""

    base: dict[str, Any] = Field(
        default_factory=dict, description="run settings of every point"
    )
    unedited: dict[str, Any] = Field(
        description="laid over a point for the run that is compared with novel views"
    )
    edited: dict[str, Any] = Field(
        description="laid over a point to edit with true edits; {folder} is where they are"
    )
    perceptual: list[str] = Field(
        default_factory=list,
        description="losses to try as perceptual distance, in order",
    )
    shipped: list[str] = Field(
        default_factory=list, description="run settings that presets may set"
    )
    data: list[str] = Field(
        default_factory=list, description="scenes measured unless others are asked for"
    )
    side: int = Field(
        512,
        ge=32,
        le=4096,
        description="side of the largest images taken from folders [pixels]",
    )
    datasets: dict[str, dict[str, Any]] = Field(
        default_factory=dict, description="settings of datasets by name"
    )
    knobs: dict[str, Knob] = Field(description="name to knob")
    combinations: list[dict[str, str]] = Field(
        default_factory=list, description="more points: values by knob"
    )


def read_plan(path: str | Path = SHIPPED) -> SweepPlan:
    """Read a knobs file. Raises SettingsError naming the key that is wrong."""
    content = read_yaml(path)
    content["combinations"] = [
        {k: str(v) for k, v in c.items()} for c in content.get("combinations", [])
    ]
    plan = make_settings(SweepPlan, content, where=str(path))
    for choice in plan.combinations:
        _settings(plan, choice)
    return plan


def make_points(
    plan: SweepPlan, names: Sequence[str] | None = None, grid: bool = False
) -> dict[str, dict[str, Any]]:
    """Return run settings by label: the base, the combinations, and every value of each knob alone.

    `names` restricts that to some knobs. With `grid`, every combination of the knobs' values
    instead. Points with the same settings are measured once.
    """
    for name in names or ():
        if name not in plan.knobs:
            known = ", ".join(plan.knobs)
            raise SettingsError(
                f"--knobs {name}: no such knob.{suggest(name, plan.knobs)} Knobs: {known}."
            )
    knobs = {
        name: knob
        for name, knob in plan.knobs.items()
        if names is None or name in names
    }
    if grid:
        choices = [
            dict(zip(knobs, values))
            for values in product(*(knob.values for knob in knobs.values()))
        ]
    else:
        alone = [{name: value} for name, knob in knobs.items() for value in knob.values]
        choices = [{}, *(c for c in plan.combinations if set(c) <= set(knobs)), *alone]
    points: dict[str, dict[str, Any]] = {}
    for choice in choices:
        settings = _settings(plan, choice)
        if settings not in points.values():
            points[
                ", ".join(f"{name} {value}" for name, value in choice.items()) or BASE
            ] = settings
    return points


def _settings(plan: SweepPlan, choice: Mapping[str, str]) -> dict[str, Any]:
    """Return the base with a choice, knob to name of the value, laid over it."""
    settings = dict(plan.base)
    for name, value in choice.items():
        known = plan.knobs[name].values if name in plan.knobs else plan.knobs
        if name not in plan.knobs or value not in known:
            raise SettingsError(
                f"combinations: {name}={value} is not a knob's value; known here: "
                f"{', '.join(known)}."
            )
        settings = merge(settings, known[value])
    return settings
