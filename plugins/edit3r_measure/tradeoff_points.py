"""The file of measured points that `edit3r run --quality` reads."""

from pathlib import Path
from typing import Any

import yaml
from pydantic import Field

from edit3r.contract.settings import Settings
from edit3r.running import SHIPPED

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
    """The content of the file."""

    measured: dict[str, Any]
    """machine, threads, versions, scenes and repeats"""
    points: list[MeasuredPoint]

    def write(self) -> Path:
        """Write what ships; returns its path."""
        text = yaml.safe_dump(
            self.model_dump(exclude_none=True), sort_keys=False, width=100
        )
        SHIPPED.write_text(_HEADER + text, encoding="utf-8")
        return SHIPPED
