"""The files behind the page of results: one a method, of this project or of anybody."""

from collections.abc import Iterator
from datetime import date
from pathlib import Path

import yaml
from pydantic import Field, model_validator

from edit3r.contract.settings import Count, Settings, make_settings
from edit3r.contract.verdicts import Label
from edit3r.kit.command.results import write_text
from edit3r.kit.files.configs import read_yaml
from edit3r_bench.report import Column

SHOWN = ("psnr", "psnr-in-edit", "ssim", "lpips", "score", "clip-t2i")
"""Measures of the page, in its order; `clip-t2i` where somebody measured it."""


class SceneFigures(Settings):
    """What a method made of one edit of one scene."""

    scene: str = Field(min_length=1)
    """the scene and its edit"""
    verdict: Label
    """of the scene, by the run itself"""
    cpu_seconds: float = Field(gt=0)
    """between photos and edited scene, in a process that has done an edit before"""
    memory_mb: float = Field(gt=0)
    """peak of the process [MiB]"""
    gaussians: Count
    """of the edited scene"""
    psnr: float = Field(gt=0, lt=100)
    """[dB] of views that no photo shows, against the edited truth"""
    psnr_in_edit: float | None = Field(None, gt=0, lt=100)
    """[dB] the same inside the edit"""
    ssim: float = Field(ge=-1, le=1)
    """of the same views"""
    lpips: float | None = Field(None, ge=0)
    """by the shift-tolerant network of stlpips_pytorch"""
    score: float = Field(ge=0, le=1)
    """the benchmark's"""
    clip_t2i: float | None = Field(None, ge=-1, le=1)
    """cosine to the description"""


class MethodResults(Settings):
    """A method of the page: its figures, or why it has none."""

    method: str = Field(min_length=1, max_length=40)
    """its name"""
    link: str = Field(pattern=r"^(https://\S+|[\w/-]+\.md)$")
    """where it is described: an address, or a page of docs/"""
    about: str = Field(min_length=1, max_length=120)
    """what it does, and how it was set, in one line"""
    hardware: str = ""
    """processor or GPU, and threads"""
    measured: date | None = None
    """the day"""
    missing: str = ""
    """why there are no figures"""
    rows: tuple[SceneFigures, ...] = ()
    """one a scene"""

    @model_validator(mode="after")
    def _measured_or_missing(self) -> "MethodResults":
        if bool(self.rows) == bool(self.missing):
            raise ValueError(
                "give either `rows` or, under `missing`, why there are none"
            )
        if self.rows and not (self.hardware and self.measured):
            raise ValueError("rows need `hardware` and the day `measured`")
        return self


def read_method_results(folder: Path) -> dict[str, MethodResults]:
    """The files of a folder by their names, by the alphabet. Raises SettingsError that names the
    file and what is wrong in it.
    """
    return {
        file.stem: make_settings(MethodResults, read_yaml(file), where=file.name)
        for file in sorted(folder.glob("*.yaml"))
    }


def write_method_results(file: Path, content: MethodResults) -> None:
    values = content.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=100)
    write_text(file, text)


def figures_of(column: Column) -> Iterator[SceneFigures]:
    """A row for each edit that is neither the first of its process, whose time is another, nor a
    failure.
    """
    for result in column.results.values():
        timing, facts = result.timing, result.facts
        if timing is None or timing["cold"]:
            continue
        known = [name for name in SHOWN if name in result.metrics]
        measures = {n.replace("-", "_"): round(result.metrics[n], 4) for n in known}
        yield SceneFigures(
            scene=result.id,
            verdict=facts["verdict"],
            cpu_seconds=round(timing["editor_cpu"] + timing["scene_cpu"], 3),
            memory_mb=round(facts["peak_memory_mb"]),
            gaussians=facts["gaussians"],
            **measures,
        )
