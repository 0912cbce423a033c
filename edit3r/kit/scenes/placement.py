"""Where a scene stands in a file whose format holds some positions only: what a file says of the
unit that it was brought into.
"""

import re
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.ply import MOST_HEADER_BYTES

PLACED = ("spz", "sog", "compressed.ply")
"""Formats, as gaussforge calls them, whose positions have limits."""
_NUMBER = rb" ([-+.0-9e]{1,30})"
_TEXT = re.compile(rb"edit3r placement: factor%b centre%b%b%b;" % ((_NUMBER,) * 4))


@dataclass(frozen=True)
class FilePlacement:
    """Positions in the file are (those of the scene - `centre`) * `factor`."""

    factor: float = 1.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def text(self) -> bytes:
        numbers = " ".join(f"{value + 0.0:.17g}" for value in self.centre)
        return f"edit3r placement: factor {self.factor:.17g} centre {numbers};".encode()

    def __str__(self) -> str:
        moved = ", ".join(f"{-value + 0.0:g}" for value in self.centre)
        parts = [f"moved by ({moved})"] * any(self.centre)
        parts += [f"made {self.factor:g} times as large"] * (self.factor != 1)
        return ", then ".join(parts)


def placed_back(gaussians: Gaussians, placement: FilePlacement) -> Gaussians:
    """The scene as it stood before `placed`."""
    means = gaussians.means.double() / placement.factor
    return replace(
        gaussians,
        means=(means + torch.tensor(placement.centre).double()).float(),
        scales=gaussians.scales / placement.factor,
    )


def placement_of(path: Path, form: str) -> FilePlacement:
    """The placement that a file states, if any."""
    if form not in PLACED:
        return FilePlacement()
    with path.open("rb") as file:
        start = file.read(MOST_HEADER_BYTES if form == "compressed.ply" else 512)
    if form == "sog":
        text = _comment_of_archive(path)
    elif form == "compressed.ply":
        text = start.partition(b"end_header")[0]
    else:
        text = start
    match = _TEXT.search(text)
    try:
        numbers = [float(number) for number in match.groups()] if match else []
    except ValueError:
        numbers = []
    if not (numbers and np.isfinite(numbers).all() and numbers[0] > 0):
        return FilePlacement()
    return FilePlacement(numbers[0], (numbers[1], numbers[2], numbers[3]))


def _comment_of_archive(path: Path) -> bytes:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.comment
    except (zipfile.BadZipFile, ValueError, OSError):
        return b""
