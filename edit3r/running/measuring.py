"""What somebody knows of places of the photos: how far apart two are, which makes the scene's unit
the metre, or three that are level, which turns the scene upright.

Photos alone tell no scale, and poses come in a unit that nobody names. How the photos were held
tells which way is up to some degrees.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Geometry
from edit3r.contract.reporting import note, say, warn
from edit3r.contract.types import Cameras, Rendering
from edit3r.kit.compute.sky import find_skies
from edit3r.kit.geometry.cameras import unproject, up_direction
from edit3r.kit.photos.framing import Frame
from edit3r.running.config import RunConfig
from edit3r.running.records import Inputs, Reconstructed
from edit3r.running.selecting.marks import read_point
from edit3r.running.unit import (
    Direction,
    KnownLength,
    KnownLevel,
    Point,
    unit_of_scene,
)

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
"""By unit."""
SHAPE = "[N:]X,Y,[N:]X,Y=LENGTH"
THREE = "[N:]X,Y,[N:]X,Y,[N:]X,Y"
FOUND = "found"
"""As `--up`: as the photos were held."""
LEAST_HEIGHT = 0.02
"""Of the triangle of three level places [its longest side], below which it tells no plane: an error
of a hundredth in depth would turn it by half a right angle."""
AROUND = 2
"""[pixels] around a place, of which it has the median surface. By eye."""
SOLID = 0.5
"""Opacity from which a pixel shows a surface; a matter of definition."""


def with_what_is_known(inputs: Inputs, config: RunConfig) -> Inputs:
    """The inputs with the length and the level places that the settings tell.

    Raises InputError for words that tell none.
    """
    for flag, text in (("--measure", config.measure), ("--up", config.up)):
        if text is not None and len(inputs.photos.images) > 1:
            raise InputError(f"{flag} {text}: takes one scene, got a batch.")
    if config.measure is not None:
        inputs = replace(inputs, length=_read_length(config.measure, inputs))
    if config.up is not None:
        inputs = replace(inputs, level=_read_level(config.up, inputs))
    return inputs


def _read_length(text: str, inputs: Inputs) -> KnownLength:
    places, _, told = text.rpartition("=")
    if places.count(",") != 3:
        raise InputError(
            f"--measure {text}: expected {SHAPE}, two places and how far apart they are, such as "
            "1:120,80,1:400,80=1.2m."
        )
    metres = read_metres(f"--measure {text}", told)
    first, second = _read_places("--measure", places, inputs)
    if first == second:
        raise InputError(f"--measure {text}: both places are the same; give two.")
    return KnownLength(text, (first, second), metres)


def read_metres(asked: str, text: str) -> float:
    """The metres of a length such as 69.4cm; raises InputError, which begins with what was
    `asked`, for what is none.
    """
    found = re.fullmatch(r"([0-9.]+(?:e-?\d+)?)\s*([a-z]*)", text.strip().lower())
    unit = "" if found is None else found[2]
    if found is not None and unit not in METRES:
        raise InputError(
            f"{asked}: got the unit {unit!r}, expected one of {', '.join(METRES)}."
        )
    try:
        metres = float(found[1]) * METRES[unit] if found is not None else 0.0
    except ValueError:
        metres = 0.0
    if not 0 < metres < float("inf"):
        raise InputError(
            f"{asked}: a length must be a number above 0 and a unit, such as 1.2m."
        )
    return metres


def _read_level(text: str, inputs: Inputs) -> KnownLevel:
    if text == FOUND:
        return KnownLevel(text)
    if text.count(",") != 5:
        raise InputError(
            f"--up {text}: photos have no axes; expected {FOUND} (as they were held), or {THREE}, "
            "three places on a floor or a table, such as 1:120,380,1:400,350,1:300,420."
        )
    places = _read_places("--up", text, inputs)
    if len({name for name, _, _ in places}) == 1:
        height, width = inputs.photos.image_size
        on_photo = torch.tensor([(x * width, y * height, 0) for _, x, y in places])
        _require_triangle(text, on_photo)
    return KnownLevel(text, places)


def _read_places(flag: str, text: str, inputs: Inputs) -> tuple[Point, ...]:
    """Places that are written one after the other."""
    views, numbers = inputs.photos, [one.strip() for one in text.split(",")]
    height, width = views.image_size
    whole = Frame((height, width), (0.0, 0.0, width, height), (height, width))
    frames = [one.frame for one in inputs.files] or [whole] * views.count
    pairs = map(",".join, zip(numbers[::2], numbers[1::2]))
    places = [read_point(flag, pair, frames) for pair in pairs]
    return tuple((views.names[view], x, y) for view, x, y in places)


def _require_triangle(text: str, places: Float[Tensor, "3 3"]) -> Float[Tensor, "3"]:
    """A unit vector at right angles to three places; raises InputError for those on one line."""
    sides = places.roll(-1, 0) - places
    normal = torch.linalg.cross(sides[0], sides[1])
    longest = sides.norm(dim=1).amax()
    if not normal.norm() > LEAST_HEIGHT * longest**2:
        raise InputError(
            f"--up {text}: the three places lie on one line, which tells no plane; choose a third "
            "one beside it."
        )
    return normal / normal.norm()


@torch.no_grad()
def measure(
    inputs: Inputs,
    geometry: Geometry | None,
    reconstructed: Reconstructed,
    rendered: Rendering,
    refine_poses: bool,
) -> Inputs:
    """The inputs with the scale and the up that what is known tells of the finished scene.

    Raises InputError for a place where the scene has no surface; warns of one whose depth the
    `geometry` only guessed.
    """
    surfaces = _Surfaces(inputs, geometry, reconstructed.cameras, rendered)
    if inputs.length is not None:
        scene = reconstructed.reconstruction
        unit = unit_of_scene(scene, inputs.photos, inputs.unit, refine_poses)
        scale = _scale(inputs.length, surfaces, float(unit.factor[0]))
        inputs = replace(inputs, scale=scale)
    if inputs.level is not None:
        up = _up(inputs.level, surfaces, reconstructed.cameras)
        inputs = replace(inputs, up=up)
    return inputs


def _scale(length: KnownLength, surfaces: "_Surfaces", unit: float) -> float:
    """What all lengths are multiplied by, once those of the run were by `unit`."""
    first, second = surfaces.at(f"--measure {length.text}", length.ends)
    apart = float((first - second).norm())
    if not apart > 0:
        raise InputError(
            f"--measure {length.text}: both places lie on one point of the scene; choose two that "
            "are farther apart."
        )
    before = apart * unit
    scale = length.metres / before
    facts = {"asked": length.text, "metres": length.metres, "factor": scale}
    note("scale.measured", facts)
    say(
        "scale.told",
        f"in metres, {scale:.4g} times as large: {length.metres:g} m were {before:.4g}",
    )
    return scale


def _up(level: KnownLevel, surfaces: "_Surfaces", cameras: Cameras) -> Direction:
    """What points up, in the frame of view 0."""
    c2w = cameras.c2w[0].double().cpu()
    held = up_direction(c2w)
    up, how = held, "as the photos were held"
    if level.places:
        places = surfaces.at(f"--up {level.text}", level.places).double().cpu()
        up = _require_triangle(level.text, places)
        # A floor is seen from above. A ceiling is not: how the photos were held outweighs that.
        seen_from = c2w[:, :3, 3].mean(0) - places.mean(0)
        if up @ (held + torch.nn.functional.normalize(seen_from, dim=0)) < 0:
            up = -up
        degrees = math.degrees(math.acos(min(1.0, max(-1.0, float(up @ held)))))
        how = (
            f"as three places lie, {degrees:.0f} degrees from how the photos were held"
        )
    x, y, z = up.tolist()
    say("up.told", f"({x:.2g}, {y:.2g}, {z:.2g}), {how}; the scene stands upright")
    return x, y, z


class _Surfaces:
    """The surfaces that the finished scene has where somebody points."""

    def __init__(
        self,
        inputs: Inputs,
        geometry: Geometry | None,
        cameras: Cameras,
        rendered: Rendering,
    ) -> None:
        self.photos, size = inputs.photos, inputs.photos.image_size
        self.geometry = None if geometry is None else geometry.at(size)
        self.cameras = cameras.at(inputs.photos.image_size)
        self.rendered = rendered
        images = [one.permute(1, 2, 0).cpu().numpy() for one in self.photos.images[0]]
        self.skies = find_skies(images)

    def at(self, asked: str, places: Sequence[Point]) -> Float[Tensor, "place 3"]:
        """In the frame of view 0. Raises InputError for a place without a surface."""
        words = ("first", "second", "third")
        called = [f"{asked}: the {word} place" for word in words]
        return torch.stack([self._at(*one) for one in zip(called, places)])

    def _at(self, called: str, place: Point) -> Float[Tensor, "3"]:
        name, x, y = place
        if name not in self.photos.names:
            raise InputError(
                f"{called} is on {name}, which is no part of the scene; choose one on another "
                "photo."
            )
        view, (height, width) = self.photos.names.index(name), self.photos.image_size
        row, column = min(int(y * height), height - 1), min(int(x * width), width - 1)
        around = (
            slice(max(0, row - AROUND), row + AROUND + 1),
            slice(max(0, column - AROUND), column + AROUND + 1),
        )
        depths = self.rendered.depths[0, view, 0][around]
        solid = (self.rendered.alphas[0, view, 0][around] > SOLID) & (depths > 0)
        is_sky = self.skies is not None and bool(self.skies[view][row, column])
        if is_sky or float(solid.float().mean()) < SOLID:
            what = "the sky" if is_sky else "nothing that the scene has a surface for"
            raise InputError(
                f"{called} shows {what}; choose one on a thing near the cameras."
            )
        if self.geometry is not None:
            measured = self.geometry.is_measured[0, view][around]
            if measured.float().mean() < SOLID:
                warn(
                    f"{called} is seen by one photo alone, which leaves its depth to a guess; "
                    "choose one that two photos show."
                )
        depth = depths[solid].median().expand(height, width)
        cameras = self.cameras
        points = unproject(depth, cameras.intrinsics[0, view], cameras.c2w[0, view])
        return points[row, column]
