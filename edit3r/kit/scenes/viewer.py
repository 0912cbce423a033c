"""The scene as one HTML page that opens from disk without a network.

It is turned, enlarged and compared by mouse or touch. The page is ours (`viewer.html`, WebGL 2)
because the ready-made exporters ask for a pinned web server stack or Node. The same page serves the
result's folder, notebooks and the app.
"""

import base64
import html
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from edit3r.contract.reporting import warn
from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.geometry.cameras import project, to_pixels
from edit3r.kit.geometry.gravity import up_direction
from edit3r.kit.geometry.harmonics import C1, C2, C3, C4, dc_to_colour
from edit3r.kit.geometry.rotations import normalise_quats
from edit3r.kit.scenes.ply import LEAST_OPACITY

__all__ = ["NamedObjects", "colours_before", "save_viewer", "viewer_page"]

EASY_GAUSSIANS = 1_500_000  # six photos of 512 pixels; more are slow to sort
MIN_STEP = 0.01  # of a harmonic; it changes a colour by less than a step of 8 bits
SAME_DEPTH = 1.05  # what lies farther than so many times the depth seen is hidden
SAME_COLOUR = 0.1  # largest difference to the edited photo of what surely shows there
LIKE_COLOUR = 0.3  # and of what likely does
NEARBY = 2  # how far from its pixel the colour of a Gaussian is looked for [pixels]
LEVEL = 3  # of compression; higher ones save a twentieth and take three times as long


@dataclass(frozen=True)
class NamedObjects:
    """Objects of a scene that can be chosen on its page."""

    names: Mapping[str, int]  # `Gaussians.object_index` by name
    # To copy, for going on with the chosen one: in it {run} becomes the page's folder and {name}
    # the object's name, quoted as a shell wants them.
    command: str = ""


NO_OBJECTS = NamedObjects({})


def save_viewer(
    path: str | Path, gaussians: Gaussians, cameras: Cameras, **texts: Any
) -> None:
    """Write the page of `viewer_page`, which explains the arguments."""
    page = viewer_page(gaussians, cameras, **texts)
    with atomic_write(path) as partial:
        # A file name in the title may be no UTF-8.
        partial.write_text(page, encoding="utf-8", errors="replace")


def viewer_page(
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    names: Sequence[str] = (),
    title: str = "",
    subtitle: str = "",
    before: Float[Tensor, "gaussian 3"] | None = None,
    looks: tuple[str, str] = ("after", "before"),
    objects: NamedObjects = NO_OBJECTS,
) -> str:
    """Return the page for one scene (batch 1); it opens at camera 0 and flies to any camera.

    Every Gaussian that can be drawn is in it. `before` holds the colours (sRGB) of a second look
    that a switch shows from the same place, see `colours_before`. `looks` name both; a second
    one with another name shows its colours alike from all sides.

    A click on one of the `objects` chooses it, to hide it or all else. Where the scene has
    `uncertainty`, a slider hides what is less sure.
    """
    if gaussians.means.shape[0] != 1 or cameras.c2w.shape[0] != 1:
        raise ValueError("save_viewer writes one scene, got a batch")
    drawn = torch.nonzero(gaussians.opacities[0] >= LEAST_OPACITY)[:, 0]
    if len(drawn) > EASY_GAUSSIANS:
        warn(
            f"The viewer page holds {len(drawn):,} Gaussians and may turn slowly; --gaussians "
            "auto leaves fewer."
        )
    if before is not None:
        before = before[drawn.to(before.device)].cpu()
    gaussians = gaussians.select(drawn).to("cpu", torch.float32)
    cameras = cameras.to("cpu", torch.float64)
    facts, data = _pack(gaussians, cameras, before, objects)
    distance = _typical_distance(gaussians, cameras)
    meta = {
        **facts,
        "distance": distance,
        "near": 1e-3 * distance,
        "up": up_direction(cameras.c2w[0]).tolist(),
        "views": _views(cameras, names),
        "size": cameras.image_size,
        "first": looks[0],
        "second": looks[1],
        "title": title,
        "subtitle": subtitle,
    }
    # No text may end the script element.
    parts = {
        "TITLE": html.escape(title or "3D scene"),
        "META": json.dumps(meta, allow_nan=False).replace("<", "\\u003c"),
        "DATA": base64.b64encode(data).decode("ascii"),
    }
    template = (
        files("edit3r.kit.scenes").joinpath("viewer.html").read_text(encoding="utf-8")
    )
    # In one pass: what a title says is never taken for a place to fill.
    return re.sub("__(TITLE|META|DATA)__", lambda place: parts[place[1]], template)


def colours_before(
    gaussians: Gaussians,
    cameras: Cameras,
    photos: Views,
    edited: Views,
    rendered: Rendering,
) -> Float[Tensor, "gaussian 3"]:
    """Return the colours (sRGB) that the Gaussians of an edited scene would have without the edit.

    For each Gaussian, the pixel most like it in colour is looked for among the nine around its
    place, in the view it came from, or in the first view that shows one of no view. The difference
    photo less edited photo at that pixel is added to its colour. What is like none of them (hidden
    things) keeps its colour. So this is a stand-in, not the scene before the edit, whose shapes may
    have been others. One scene (batch 1).
    """
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    view_index = gaussians.view_index
    found = torch.zeros_like(view_index, dtype=torch.bool)
    for view in range(cameras.count):
        places, depths = project(
            gaussians.means[0], cameras.intrinsics[0, view], cameras.c2w[0, view]
        )
        maps = (photos.images, edited.images, rendered.depths)
        values = torch.cat([each[:, view] for each in maps], 1).to(colours)
        change, difference, depth_seen = _most_alike(colours, places, values)
        likely = (difference < LIKE_COLOUR) & (depths < SAME_DEPTH * depth_seen)
        inside = ((places > 0) & (places < 1)).all(-1) & (depths > 0)
        of_view = (view_index == view) | (view_index < 0)
        mine = ((difference < SAME_COLOUR) | likely) & inside & of_view & ~found
        colours = torch.where(mine[:, None], colours + change, colours)
        found |= mine
    return colours


def _most_alike(
    colours: Float[Tensor, "gaussian 3"],
    places: Float[Tensor, "gaussian 2"],
    values: Float[Tensor, "1 7 height width"],
) -> tuple[
    Float[Tensor, "gaussian 3"], Float[Tensor, "gaussian"], Float[Tensor, "gaussian"]
]:
    """At the most alike of nine pixels: what the edit changed there and how alike it is.

    Also the farthest depth of the nine. `values` holds photo, edited photo and depth.
    """
    pixel = 1 / places.new_tensor([values.shape[3], values.shape[2]])
    change = torch.zeros_like(colours)
    least = torch.full_like(colours[:, 0], torch.inf)
    farthest = torch.zeros_like(least)
    shifts = torch.arange(-1, 2).to(places)
    for shift in torch.cartesian_prod(shifts, shifts):
        grid = 2 * (places + NEARBY * shift * pixel) - 1
        sampled = torch.nn.functional.grid_sample(
            values,
            grid[None, None].to(colours),
            mode="nearest",
            padding_mode="border",
            align_corners=False,
        )
        photo, edit, depth = sampled[0, :, 0].T.split((3, 3, 1), 1)
        difference = (colours - edit).abs().amax(-1)
        change = torch.where((difference < least)[:, None], photo - edit, change)
        least = torch.minimum(difference, least)
        farthest = torch.maximum(depth[:, 0], farthest)
    return change, least, farthest


def _pack(
    gaussians: Gaussians,
    cameras: Cameras,
    before: Float[Tensor, "gaussian 3"] | None,
    objects: NamedObjects,
) -> tuple[dict[str, Any], bytes]:
    """What the page must know to unpack the data, and the data.

    The data are planes of one byte a Gaussian, compressed. Centres are directions (octahedral, 2 x
    16 bits) and logarithmic distances (16 bits) from the middle of the cameras, so errors are small
    as the photos see them: 1/60 of a pixel at 512 pixels. Colours, scales (logarithmic), opacities
    and quaternions have 8 bits, harmonics steps of 0.01 where 8 bits reach. Neighbours in a photo
    are neighbours in the data: of what is alike there, differences are stored. Objects are places
    among the names from 1 (0: none; 16 bits), uncertainty has 8 bits.
    """
    eye = cameras.c2w[0, :, :3, 3].mean(0).numpy()
    offsets = gaussians.means[0].double().numpy() - eye
    distances = np.log(np.linalg.norm(offsets, axis=1).clip(1e-9))
    far, distance_low, distance_step = _in_steps(distances, 65535)
    directions = (_octahedral(offsets) + 1) * 32767.5
    centres = np.column_stack((directions, far)).round().astype("<u2")
    centres = _differences(centres)

    colours = dc_to_colour(gaussians.harmonics[0, :, 0]).clamp(-0.5, 1.5).numpy()
    low = min(0.0, float(colours.min(initial=0)))
    step = (max(1.0, float(colours.max(initial=1))) - low) / 255
    after = _bytes((colours - low) / step)
    logs = gaussians.scales[0].clamp(min=1e-12).log().numpy()
    scales, scale_low, scale_step = _in_steps(logs, 255)
    harmonics = gaussians.harmonics[0, :, 1:].flatten(1).numpy()
    harmonics_step = max(MIN_STEP, float(np.abs(harmonics).max(initial=0)) / 127)
    planes = [
        centres & 255,
        centres >> 8,
        _differences(after),
        _bytes(gaussians.opacities[0][:, None].numpy() * 255),
        _differences(_bytes(scales)),
        _signed_bytes(normalise_quats(gaussians.quats[0]).numpy() * 127),
    ]
    if before is not None:
        levels = (before.clamp(-0.5, 1.5).numpy() - low) / step
        planes.append(_bytes(levels.clip(0, 255)) - after)
    planes.append(_signed_bytes(harmonics / harmonics_step))
    facts = {
        "count": gaussians.count,
        "degree": gaussians.degree,
        "before": before is not None,
        "eye": eye.tolist(),
        "distanceLow": distance_low,
        "distanceStep": distance_step,
        "scaleLow": scale_low,
        "scaleStep": scale_step,
        "colourLow": low,
        "colourStep": step,
        "harmonicsStep": harmonics_step,
        "factors": [-C1, C1, -C1, *C2, *C3, *C4],
    }
    if objects.names:
        places = np.zeros((gaussians.count, 1), np.uint16)
        for place, index in enumerate(objects.names.values(), 1):
            places[gaussians.objects.numpy() == index] = place
        planes += [places & 255, places >> 8]
        facts |= {"named": [*objects.names], "command": objects.command}
    if gaussians.uncertainty is not None:
        planes.append(_bytes(gaussians.uncertainty[0][:, None].numpy() * 255))
        facts["unsure"] = True
    data = b"".join(plane.astype(np.uint8).tobytes("F") for plane in planes)
    return facts, zlib.compress(data, LEVEL)


def _octahedral(
    offsets: Float64[np.ndarray, "gaussian 3"],
) -> Float64[np.ndarray, "gaussian 2"]:
    """Directions on an octahedron that is unfolded into the square [-1, 1]^2."""
    sums = np.abs(offsets).sum(1, keepdims=True)
    plane = offsets / sums.clip(1e-12)
    xy = plane[:, :2]
    folded = (1 - np.abs(xy[:, ::-1])) * np.where(xy < 0, -1, 1)
    return np.where(plane[:, 2:] < 0, folded, xy)


def _in_steps(values: np.ndarray, levels: int) -> tuple[np.ndarray, float, float]:
    """The values in steps from their lowest, that lowest, and the step."""
    low = float(values.min()) if values.size else 0.0
    high = float(values.max()) if values.size else 0.0
    step = max((high - low) / levels, 1e-9)
    return (values - low) / step, low, step


def _bytes(values: np.ndarray) -> np.ndarray:
    return values.round().astype(np.uint8)


def _signed_bytes(values: np.ndarray) -> np.ndarray:
    return values.round().astype(np.int8).view(np.uint8)


def _differences(rows: np.ndarray) -> np.ndarray:
    """Of each row to the one before; unsigned numbers wrap around, as sums on the page do."""
    return np.diff(rows, axis=0, prepend=np.zeros_like(rows[:1]))


def _typical_distance(gaussians: Gaussians, cameras: Cameras) -> float:
    """Median depth in camera 0 of the visible Gaussians in front of it; 1 without any."""
    pose = cameras.c2w[0, 0].float()
    depths = (gaussians.means[0] - pose[:3, 3]) @ pose[:3, 2]
    depths = depths[(depths > 0) & (gaussians.opacities[0] > 0.1)]
    return float(depths.median()) if len(depths) else 1.0


def _views(cameras: Cameras, names: Sequence[str]) -> list[dict[str, Any]]:
    """Name, K [pixels] and c2w of each camera."""
    pixels = to_pixels(cameras.intrinsics[0], cameras.image_size).tolist()
    names = [*names, *(f"view {index}" for index in range(len(names), cameras.count))]
    poses = cameras.c2w[0].tolist()
    return [
        {"name": name, "K": k, "c2w": c2w} for name, k, c2w in zip(names, pixels, poses)
    ]
