"""Presets: measured settings of a run, from `--quality`.

What a preset says lies under everything else the user says. The points are in
`presets/quality.yaml`, measured as docs/tradeoff.md says.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import note
from edit3r.contract.settings import Settings, make_settings, merge
from edit3r.kit.files.configs import read_yaml

PRESETS = ("fast", "balanced", "best")  # quickest first

SHIPPED = Path(__file__).parent / "presets" / "quality.yaml"
_HEADER = """\
# Measured settings of a run, chosen by `--quality`; see docs/tradeoff.md for how they are written.
"""


class Expected(Settings):
    """What a run at a point took and gave on one kind of scene."""

    seconds: float = Field(gt=0)
    """processor time of a run without an editor, in a process that has done one before; the
    quickest of several, mean of the scenes
    """
    seconds_first: float = Field(gt=0)
    """of the first run of a process, as a run of the command is; mean of scenes"""
    memory_mb: float = Field(gt=0)
    """peak of the process [MiB]"""
    gaussians: int = Field(ge=0)
    """largest number of Gaussians of the scenes"""
    psnr: float
    """novel view [dB]"""
    ssim: float
    """novel view"""
    lpips: float | None = None
    """novel view, by the weights that `measured` names; None: not measured"""

    @property
    def accuracy(self) -> float:
        """What points are ranked by, more is better: LPIPS turned round, since PSNR hardly tells
        sharp from blurred; PSNR where LPIPS was not measured.
        """
        return self.psnr if self.lpips is None else -self.lpips


class MeasuredPoint(Settings):
    """One choice of run settings, and what it took and gave."""

    label: str
    preset: str | None = None
    """fast, balanced or best"""
    settings: dict[str, Any]
    """run settings"""
    expected: dict[str, Expected]
    """by kind of scene"""

    @property
    def seconds(self) -> float:
        """On the slower kind of scene."""
        return max(expected.seconds for expected in self.expected.values())

    @property
    def accuracy(self) -> float:
        """Mean over the kinds of scene."""
        return sum(e.accuracy for e in self.expected.values()) / len(self.expected)


class Quality(Settings):
    """The content of the file of measured points."""

    measured: dict[str, Any]
    """machine, threads, versions, scenes and repeats"""
    points: list[MeasuredPoint]

    def preset(self, name: str) -> MeasuredPoint:
        """The point of a preset; raises SettingsError where none was measured."""
        for point in self.points:
            if point.preset == name:
                return point
        raise SettingsError(
            f"--quality {name}: there is no measured preset of that name; see docs/tradeoff.md."
        )


def read_quality(path: Path | None = None) -> Quality:
    path = path or SHIPPED
    return make_settings(Quality, read_yaml(path), where=str(path))


def write_quality(quality: Quality, path: Path | None = None) -> Path:
    """Write the file that `edit3r run --quality` reads."""
    path = path or SHIPPED
    content = quality.model_dump(exclude_none=True)
    text = yaml.safe_dump(content, sort_keys=False, width=100)
    path.write_text(_HEADER + text, encoding="utf-8")
    return path


def with_quality(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Run settings over those of the preset that they name."""
    name = settings.get("quality")
    if name not in PRESETS:  # none, or one that the settings' own check refuses
        return dict(settings)
    point = read_quality().preset(name)
    usable = {k: v for k, v in point.settings.items() if _fits(v, settings.get(k))}
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
    name = values["quality"]
    quality = read_quality()
    point = quality.preset(name)
    differing = [k for k, v in point.settings.items() if not _agrees(values.get(k), v)]
    facts = {
        "preset": name,
        "chosen": point.label,
        "settings": point.settings,
        "overridden": differing,
        "expected": {kind: e.model_dump() for kind, e in point.expected.items()},
        "measured": quality.measured,
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
