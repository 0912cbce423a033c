"""The Gaussians in the formats of other programs, most of them by gaussforge."""

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float, Int

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.contract.reporting import say, warn
from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.axes import LEAST_OPACITY, UP_AND_BACK, flipped
from edit3r.kit.scenes.placement import PLACED, FilePlacement
from edit3r.kit.scenes.ply import VIEWER_DEGREE, save_ply
from edit3r.kit.scenes.reading import convert
from edit3r_outputs.placing import fitting, placed, with_placement

# The numbers of this block: no figures kept.
CHUNK = 256  # Gaussians of a compressed PLY that share a box
STEPS = 1024  # of an axis of a box
MANY_OFF = 0.02  # share of the Gaussians that may miss their place without a word
STRAY = 0.005  # share on each side of an axis that may be strays
CELL_BITS = 12  # of an axis, by which neighbours are found
MANY_CLIPPED = 0.01  # share of the Gaussians whose colours may be cut without a word


@dataclass(frozen=True)
class Held:
    """The most that a format can say."""

    size: float  # of a Gaussian
    plain: float  # harmonics of degree 0
    further: float  # and of the degrees above


# The numbers of this block: no figures kept.
_HELD = {
    "spz": Held(math.exp(5.9375), 10 / 3, 1.0),
    "compressed.ply": Held(math.exp(20), math.inf, 4.0),
}


class PlyWriter(Writer):
    """The PLY of 3D Gaussian Splatting, with what viewers read of it."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        tell_of_losses(scene.gaussians, "ply")
        save_ply(path, scene.gaussians, degree=VIEWER_DEGREE)


class GaussforgeWriter(Writer):
    """A format that gaussforge writes, by its name there."""

    form: ClassVar[str]
    spz_version: ClassVar[int] = 3

    def write(self, path: Path, scene: SceneToWrite) -> None:
        _write(path, scene.gaussians, self.form, self.spz_version)


class SpzWriter(GaussforgeWriter):
    """SPZ of version 3, one gzip stream."""

    form = "spz"


class Spz4Writer(GaussforgeWriter):
    """SPZ of version 4, which is coded with zstd."""

    form, spz_version = "spz", 4


class SogWriter(GaussforgeWriter):
    """SOG, PlayCanvas' images of quantised columns."""

    form = "sog"


class SplatWriter(GaussforgeWriter):
    """The 32 bytes a Gaussian of the first web viewers."""

    form = "splat"


class CompressedPlyWriter(GaussforgeWriter):
    """PlayCanvas' PLY of quantised columns."""

    form = "compressed.ply"


def _write(path: Path, gaussians: Gaussians, form: str, spz_version: int) -> None:
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
    in_file = placed(gaussians, placement)
    _tell_of_clipping(in_file, form)
    if form == "spz":  # whose axes gaussforge leaves to those who use it
        in_file = flipped(in_file, UP_AND_BACK)
    if form == "compressed.ply":
        in_file = _by_colour(_in_chunks(in_file))
    with tempfile.TemporaryDirectory() as scratch:
        plain, target = Path(scratch) / "scene.ply", Path(scratch) / "written"
        save_ply(plain, in_file, degree=VIEWER_DEGREE)
        convert(plain, target, "ply", form, spz_version=spz_version)
        content = target.read_bytes()
    if placement != FilePlacement():
        content = with_placement(content, form, placement)
        say(
            f"{form}.unit",
            f"cannot hold the scene where it stands, so in the file it is {placement}; edit3r "
            "undoes that when it reads the file, other programs do not",
        )
    path.write_bytes(content)


def tell_of_losses(gaussians: Gaussians, form: str) -> None:
    """A line for each thing that the scene has and the file will not.

    Raises InputError for a scene without Gaussians.
    """
    if not gaussians.count:
        raise InputError(f"{form}: the scene has no Gaussians to write.")
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
            warn(f"{form}: cannot store {name}, which are dropped.")


def _tell_of_clipping(gaussians: Gaussians, form: str) -> None:
    """Warn of sizes and colours that the format cuts to what it holds."""
    most = _HELD.get(form)
    if most is None:
        return
    drawn = gaussians.opacities[0] >= LEAST_OPACITY
    large = int((gaussians.scales[0].amax(1) > most.size)[drawn].sum())
    if large:
        warn(
            f"{form}: {large:,} Gaussians are larger than it can store ({most.size:.3g} in the "
            "file's unit) and are reduced to that."
        )
    sizes = gaussians.harmonics[0, drawn].abs().flatten(1)
    beyond = (sizes[:, :3] > most.plain).any(1) | (sizes[:, 3:] > most.further).any(1)
    if beyond.float().sum() > MANY_CLIPPED * len(beyond):
        warn(
            f"{form}: the colours of {int(beyond.sum()):,} Gaussians are beyond what it can store "
            "and are clipped."
        )


def _by_colour(gaussians: Gaussians) -> Gaussians:
    """The scene in the order that makes gaussforge 0.6 write it right.

    It writes the harmonics of a compressed PLY by coefficient; the format (and its own reader) has
    them by colour.
    """
    kept = gaussians.harmonics[:, :, : (VIEWER_DEGREE + 1) ** 2]
    by_colour = kept[:, :, 1:].transpose(2, 3).reshape(kept[:, :, 1:].shape)
    return replace(gaussians, harmonics=torch.cat((kept[:, :, :1], by_colour), 2))


def _in_chunks(gaussians: Gaussians) -> Gaussians:
    """Neighbours beside each other: CHUNK in a row share a box, and each stands at a step of it."""
    means = gaussians.means[0].double().numpy(force=True)
    order = _near_each_other(means)
    means = means[order]
    sizes = gaussians.scales[0].amax(1).numpy(force=True)[order]
    starts = range(0, len(means), CHUNK)
    boxes = np.array([np.ptp(means[i : i + CHUNK], axis=0).max() for i in starts])
    off = int((np.repeat(boxes / STEPS, CHUNK)[: len(sizes)] > sizes).sum())
    if off > MANY_OFF * len(sizes):
        warn(
            f"compressed.ply: {off:,} of {len(sizes):,} Gaussians are moved by about their own "
            "size, since others lie far from the rest; spz, sog, splat and glb avoid that."
        )
    return gaussians.select(torch.from_numpy(order))


def _near_each_other(
    means: Float[np.ndarray, "gaussian 3"],
) -> Int[np.ndarray, "gaussian"]:
    """The order along a Morton curve, in which neighbours follow each other; strays come last."""
    low, high = np.quantile(means, (STRAY, 1 - STRAY), axis=0)
    extent = max((high - low).max(), 1e-30)
    places = (means - (low + high) / 2) / extent  # in [-0.5, 0.5], beside strays
    strays = (abs(places) > 1).any(1)
    cells = ((places.clip(-1, 1) + 1) / 2 * (2**CELL_BITS - 1)).astype(np.int64)
    code = strays.astype(np.int64) << 3 * CELL_BITS
    for bit in range(CELL_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
