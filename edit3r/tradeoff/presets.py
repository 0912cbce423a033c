"""The measured points that ship with edit3r, and which of them are the presets: `edit3r/presets/quality.yaml`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from edit3r.config import Settings, make_settings, read_yaml
from edit3r.tradeoff.figures import MeasuredPoint
from edit3r.tradeoff.front import PRESETS, Rated, choose_presets, on_every_front

SHIPPED = Path(__file__).parents[1] / "presets" / "quality.yaml"
_HEADER = "# Measured and written by `edit3r tradeoff --update-presets`; see docs/tradeoff.md.\n"


class Expected(Settings):
    """What a point took and gave on one kind of scene."""

    seconds: float = Field(gt=0, description="of all stages of a run without an editor, by the stated clock")
    seconds_least: float = Field(gt=0, description="quickest of the repeats, mean over the scenes")
    seconds_most: float = Field(gt=0, description="slowest of the repeats, mean over the scenes")
    memory_mb: float = Field(gt=0, description="peak of the process [MiB]")
    start_memory_mb: float = Field(ge=0, description="of which before anything was made [MiB]")
    gaussians: int = Field(ge=0, description="largest number of Gaussians of the scenes")
    psnr: float = Field(description="novel view [dB]")
    ssim: float = Field(description="novel view")


class ShippedPoint(Settings):
    """One measured point on the front."""

    label: str
    preset: str | None = Field(None, description="fast, balanced or best")
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


def make_quality(
    points: Sequence[MeasuredPoint], measured: Mapping[str, Any], clock: str, apart: float, kept: Sequence[str]
) -> Quality:
    """Points on the front of every kind of scene, the presets among them marked.

    Of a point's settings only `kept`, the ones knobs turn, are shipped: the rest of a run is the user's.
    """
    rated = [point.rated(clock) for point in points]
    on_front = on_every_front(rated)
    chosen = {point.name: preset for preset, point in choose_presets(rated, apart).items()}
    shipped = [_shipped(p, clock, chosen.get(p.label), kept) for p, flag in zip(points, on_front) if flag]
    return Quality(measured={**measured, "clock": clock}, points=sorted(shipped, key=lambda p: p.seconds))


def _shipped(point: MeasuredPoint, clock: str, preset: str | None, kept: Sequence[str]) -> ShippedPoint:
    settings = {key: value for key, value in point.settings.items() if key in kept}
    return ShippedPoint(
        label=point.label,
        preset=preset,
        settings=settings,
        expected={kind: _expected(figures, getattr(figures, clock)) for kind, figures in point.kinds.items()},
    )


def _expected(figures: Any, seconds: Any) -> Expected:
    return Expected(
        seconds=round(seconds.middle, 3),
        seconds_least=round(seconds.least, 3),
        seconds_most=round(seconds.most, 3),
        memory_mb=round(figures.memory_mb),
        start_memory_mb=round(figures.start_memory_mb),
        gaussians=round(figures.most_gaussians),
        psnr=round(figures.psnr, 2),
        ssim=round(figures.ssim, 4),
    )


def write_quality(quality: Quality, path: Path | None = None) -> Path:
    """Write the file that `edit3r run --quality` reads."""
    path = path or SHIPPED
    text = yaml.safe_dump(quality.model_dump(exclude_none=True), sort_keys=False, width=110)
    path.write_text(_HEADER + text, encoding="utf-8")
    return path


def preset_names(quality: Quality) -> list[str]:
    """The presets there are, quickest first."""
    return [name for name in PRESETS if any(point.preset == name for point in quality.points)]


__all__ = [
    "SHIPPED",
    "Expected",
    "Quality",
    "Rated",
    "ShippedPoint",
    "asdict",
    "make_quality",
    "preset_names",
    "read_quality",
    "write_quality",
]
