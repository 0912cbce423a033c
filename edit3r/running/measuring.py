"""A length that somebody knows between two places of the photos: the scene is then in metres.

Photos alone tell no scale, and poses come in a unit that nobody names.
"""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import note, say
from edit3r.contract.types import Cameras, Rendering
from edit3r.kit.compute.sky import find_skies
from edit3r.kit.geometry.cameras import unproject
from edit3r.kit.photos.framing import Frame
from edit3r.running.records import Inputs, Reconstructed
from edit3r.running.scale import KnownLength, unit_of_scene
from edit3r.running.selecting.marks import read_point

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""By unit."""
SHAPE = "[N:]X,Y,[N:]X,Y=LENGTH"
AROUND = 2
"""[pixels] around a place, of which it has the median surface. By eye."""
SOLID = 0.5
"""Opacity from which a pixel shows a surface; a matter of definition."""


def with_known_length(inputs: Inputs, text: str) -> Inputs:
    """The inputs with the length that `text` tells. Raises InputError for what tells none."""
    if inputs.scene is not None:
        raise InputError(
            f"--measure {text}: a given scene keeps its unit; only scenes made of photos take one."
        )
    if len(inputs.photos.images) > 1:
        raise InputError(f"--measure {text}: takes one scene, got a batch.")
    length = _read(text, inputs)
    return replace(inputs, length=length)


def _read(text: str, inputs: Inputs) -> KnownLength:
    places, _, told = text.rpartition("=")
    numbers = [one.strip() for one in places.split(",")]
    found = re.fullmatch(r"([0-9.]+(?:e-?\d+)?)\s*([a-z]*)", told.strip().lower())
    if len(numbers) != 4 or found is None:
        raise InputError(
            f"--measure {text}: expected {SHAPE}, two places and how far apart they are, such as "
            "1:120,80,1:400,80=1.2m."
        )
    if found[2] not in METRES:
        raise InputError(
            f"--measure {text}: got the unit {found[2]!r}, expected one of {', '.join(METRES)}."
        )
    try:
        metres = float(found[1]) * METRES[found[2]]
    except ValueError:
        metres = 0.0
    if not 0 < metres < float("inf"):
        raise InputError(f"--measure {text}: a length must be a number above 0.")
    views = inputs.photos
    height, width = views.image_size
    whole = Frame((height, width), (0.0, 0.0, width, height), (height, width))
    frames = [one.frame for one in inputs.files] or [whole] * views.count
    pairs = (",".join(numbers[:2]), ",".join(numbers[2:]))
    first, second = (read_point("--measure", pair, frames) for pair in pairs)
    if first == second:
        raise InputError(f"--measure {text}: both places are the same; give two.")
    ends = tuple((views.names[view], x, y) for view, x, y in (first, second))
    return KnownLength(text, (ends[0], ends[1]), metres)


@torch.no_grad()
def measure(
    inputs: Inputs,
    length: KnownLength,
    reconstructed: Reconstructed,
    rendered: Rendering,
    refine_poses: bool,
) -> Inputs:
    """The inputs with the scale that a known length gives the finished scene.

    Raises InputError for a place where the scene has no surface.
    """
    cameras = reconstructed.cameras.at(inputs.photos.image_size)
    images = [one.permute(1, 2, 0).cpu().numpy() for one in inputs.photos.images[0]]
    skies = find_skies(images)
    first, second = (
        _surface(length, which, inputs, skies, rendered, cameras) for which in (0, 1)
    )
    apart = float((first - second).norm())
    if not apart > 0:
        raise InputError(
            f"--measure {length.text}: both places lie on one point of the scene; choose two that "
            "are farther apart."
        )
    scene = reconstructed.reconstruction
    unit = unit_of_scene(scene, inputs.photos, inputs.unit, refine_poses)
    before = apart * float(unit.factor[0])
    scale = length.metres / before
    facts = {"asked": length.text, "metres": length.metres, "factor": scale}
    note("scale.measured", facts)
    say(
        "scale.told",
        f"in metres, {scale:.4g} times as large: {length.metres:g} m were {before:.4g}",
    )
    return replace(inputs, scale=scale)


def _surface(
    length: KnownLength,
    which: int,
    inputs: Inputs,
    skies: Sequence[Bool[np.ndarray, "height width"]] | None,
    rendered: Rendering,
    cameras: Cameras,
) -> Float[Tensor, "3"]:
    """Where the scene's surface is at one end of a length."""
    name, x, y = length.ends[which]
    called = f"--measure {length.text}: the {('first', 'second')[which]} place"
    if name not in inputs.photos.names:
        raise InputError(
            f"{called} is on {name}, which is no part of the scene; choose one on another photo."
        )
    view, (height, width) = inputs.photos.names.index(name), inputs.photos.image_size
    row, column = min(int(y * height), height - 1), min(int(x * width), width - 1)
    around = (
        slice(max(0, row - AROUND), row + AROUND + 1),
        slice(max(0, column - AROUND), column + AROUND + 1),
    )
    depths = rendered.depths[0, view, 0][around]
    solid = (rendered.alphas[0, view, 0][around] > SOLID) & (depths > 0)
    is_sky = skies is not None and bool(skies[view][row, column])
    if is_sky or float(solid.float().mean()) < SOLID:
        what = "the sky" if is_sky else "nothing that the scene has a surface for"
        raise InputError(
            f"{called} shows {what}; choose one on a thing near the cameras."
        )
    depth = depths[solid].median().expand(height, width)
    points = unproject(depth, cameras.intrinsics[0, view], cameras.c2w[0, view])
    return points[row, column]
