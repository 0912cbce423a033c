"""The measured points that ship with edit3r, and which of them are the presets: `edit3r/presets/quality.yaml`."""

from pathlib import Path
from typing import Any

import yaml
from edit3r_measure.tradeoff.front import PRESETS
from pydantic import Field

from edit3r.config import Settings, make_settings, read_yaml

SHIPPED = Path(__file__).parent / "presets" / "quality.yaml"
_HEADER = "# Measured and written by `edit3r tradeoff --update-presets`; see docs/tradeoff.md.\n"


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
    """The file."""

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
