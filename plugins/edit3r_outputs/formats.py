"""The Gaussians in the formats of other programs, most of them by gaussforge."""

import tempfile
from dataclasses import replace
from pathlib import Path

import torch

from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.contract.reporting import say, warn
from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.placement import (
    PLACED,
    FilePlacement,
    fitting,
    placed,
    with_placement,
)
from edit3r.kit.scenes.ply import VIEWER_DEGREE, save_ply
from edit3r.kit.scenes.read import convert


class PlyWriter(Writer):
    """The PLY of 3D Gaussian Splatting, with what viewers read of it."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        tell_of_losses(scene.gaussians, "ply")
        save_ply(path, scene.gaussians, degree=VIEWER_DEGREE)


class SpzWriter(Writer):
    """SPZ of version 3, one gzip stream."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        _write(path, scene.gaussians, "spz")


class Spz4Writer(Writer):
    """SPZ of version 4, which is coded with zstd."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        _write(path, scene.gaussians, "spz", spz_version=4)


class SogWriter(Writer):
    """SOG, PlayCanvas' images of quantised columns."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        _write(path, scene.gaussians, "sog")


class SplatWriter(Writer):
    """The 32 bytes a Gaussian of the first web viewers."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        _write(path, scene.gaussians, "splat")


class CompressedPlyWriter(Writer):
    """PlayCanvas' PLY of quantised columns."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        _write(path, scene.gaussians, "compressed.ply")


def _write(path: Path, gaussians: Gaussians, form: str, spz_version: int = 3) -> None:
    """Let gaussforge write one of its formats, and say what is lost that a viewer would show."""
    tell_of_losses(gaussians, form)
    placement = FilePlacement()
    if form in PLACED:
        every = gaussians.count
        gaussians, placement = fitting(gaussians, form)
        if gaussians.count < every:
            warn(
                f"{form}: {every - gaussians.count:,} Gaussians lie too far from the rest for "
                "this format and are left out."
            )
    if form == "compressed.ply":
        gaussians = _by_colour(gaussians)
    with tempfile.TemporaryDirectory() as scratch:
        plain, made = Path(scratch) / "scene.ply", Path(scratch) / "made"
        save_ply(plain, placed(gaussians, placement), degree=VIEWER_DEGREE)
        convert(plain, made, "ply", form, spz_version=spz_version)
        content = made.read_bytes()
    if placement != FilePlacement():
        content = with_placement(content, form, placement)
        say(
            f"{form}.unit",
            f"cannot hold the scene where it stands, so in the file it is {placement}; edit3r "
            "undoes that when it reads the file, other programs do not",
        )
    path.write_bytes(content)


def tell_of_losses(gaussians: Gaussians, form: str) -> None:
    """A line for each thing that the scene has and the file will not."""
    most = 0 if form == "splat" else VIEWER_DEGREE
    kept = f"only degree {most} of it is kept" if most else "it is dropped"
    if gaussians.degree > most:
        warn(
            f"{form}: the colour that depends on the direction is of degree {gaussians.degree}; "
            f"{kept}."
        )
    lost = {"objects": gaussians.object_index, "uncertainty": gaussians.uncertainty}
    for name in (name for name, values in lost.items() if values is not None):
        if form != "ply":
            warn(f"{form}: has no place for {name}, which are dropped.")


def _by_colour(gaussians: Gaussians) -> Gaussians:
    """The scene in the order that makes gaussforge 0.6 write it right.

    It writes the harmonics of a compressed PLY by coefficient; the format (and its own reader) has
    them by colour.
    """
    kept = gaussians.harmonics[:, :, : (VIEWER_DEGREE + 1) ** 2]
    by_colour = kept[:, :, 1:].transpose(2, 3).reshape(kept[:, :, 1:].shape)
    return replace(gaussians, harmonics=torch.cat((kept[:, :, :1], by_colour), 2))
