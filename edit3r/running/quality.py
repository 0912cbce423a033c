"""Presets: measured settings of a run, from `--quality`.

What a preset says lies under everything else the user says. The points are in
`presets/quality.yaml`, which `edit3r tradeoff` writes (docs/tradeoff.md).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import note
from edit3r.contract.settings import Settings, merge
from edit3r.kit.files.configs import read_yaml

PRESETS = ("fast", "balanced", "best")  # quickest first
SHIPPED = Path(__file__).parent / "presets" / "quality.yaml"


def preset_point(name: str) -> dict[str, Any]:
    """The measured point of a preset: its label, settings, and the figures expected of it."""
    for point in read_yaml(SHIPPED)["points"]:
        if point.get("preset") == name:
            return point
    raise SettingsError(
        f"--quality {name}: there is no measured preset of that name; see docs/tradeoff.md."
    )


def with_quality(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Run settings over those of the preset that they name."""
    name = settings.get("quality")
    if name not in PRESETS:  # none, or one that the settings' own check refuses
        return dict(settings)
    chosen = preset_point(name)["settings"]
    usable = {k: v for k, v in chosen.items() if _fits(v, settings.get(k))}
    return merge(usable, settings)


def _fits(chosen: Any, given: Any) -> bool:
    """Settings of one component are of no use to another."""
    chosen_name, given_name = (
        value.get("name") if isinstance(value, Mapping) else value
        for value in (chosen, given)
    )
    return given_name is None or chosen_name is None or chosen_name == given_name


def note_quality(config: Settings) -> None:
    """Note for `run.json` what the chosen preset says, what it costs, and what differs from it."""
    values = config.model_dump()
    point = preset_point(values["quality"])
    chosen = point["settings"]
    facts = {
        "preset": values["quality"],
        "chosen": point["label"],
        "settings": chosen,
        "overridden": [k for k, v in chosen.items() if not _agrees(values.get(k), v)],
        "expected": point["expected"],
        "measured": read_yaml(SHIPPED)["measured"],
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
