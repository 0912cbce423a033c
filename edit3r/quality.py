"""Measured settings of a run: what `--quality` chooses, and the file it is chosen from.

A preset is one measured point. What is chosen lies under everything else the user says. The points are in
`edit3r/presets/quality.yaml`, measured as docs/tradeoff.md says.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

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

    seconds: float = Field(gt=0, description="all stages of a run without an editor, quickest repeats; mean of scenes")
    seconds_first: float = Field(gt=0, description="first run of a process, as a run of the command is; mean of scenes")
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


def preset_point(name: str, quality: Quality | None = None) -> ShippedPoint:
    """The measured point that a preset is. Raises SettingsError where none was measured."""
    point = next((point for point in (quality or read_quality()).points if point.preset == name), None)
    if point is None:
        raise SettingsError(f"--quality {name}: no such preset was measured; see docs/tradeoff.md.")
    return point


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


def with_quality(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Run settings, completed by the measured point that their `quality` names."""
    name = settings.get("quality")
    if name not in PRESETS:
        return dict(settings)
    chosen = preset_point(name).settings
    return merge({key: value for key, value in chosen.items() if _fits(value, settings.get(key))}, settings)


def _fits(chosen: Any, given: Any) -> bool:
    """Whether a chosen setting may lie under a given one: settings of one component are of no use to another."""
    names = [value.get("name") if isinstance(value, Mapping) else value for value in (chosen, given)]
    return None in names or names[0] == names[1]


def note_quality(config: Mapping[str, Any], photos: int) -> None:
    """Note for `run.json` which measured point the settings chose, its expected cost, and what differs from it."""
    if config.get("quality") is None:
        return
    most = config.get("views")
    photos = min(photos, most) if isinstance(most, int) else photos
    quality = read_quality()
    point = preset_point(config["quality"], quality)
    expected = expectation(point, photos / quality.photos)
    facts = {
        "chosen": point.label,
        "preset": point.preset,
        "settings": point.settings,
        "overridden": [key for key, value in point.settings.items() if not _agrees(config.get(key), value)],
        "expected": {key: round(value, 4) for key, value in expected.items()},
        "expected_for": f"a run without an editor on {photos} photos, on the worse of the measured kinds of scene",
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
