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
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from edit3r.contract.interfaces import NamedObjects, SceneToWrite, Writer
from edit3r.contract.reporting import warn
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.cameras import to_pixels, up_direction
from edit3r.kit.geometry.harmonics import C1, C2, C3, C4, dc_to_colour
from edit3r.kit.geometry.rotations import normalise_quats
from edit3r.kit.scenes.axes import LEAST_OPACITY

EASY_GAUSSIANS = 1_500_000  # six photos of 512 pixels; more are slow to sort
# of a harmonic; it changes a colour by less than a step of 8 bits; no figure kept
MIN_STEP = 0.01
LEVEL = 3  # of compression; higher ones save a twentieth and take three times as long


class ViewerWriter(Writer):
    """The page, which opens from disk in any browser with WebGL 2."""

    needs = ("cameras",)

    def write(self, path: Path, scene: SceneToWrite) -> None:
        # A file name in the title may be no UTF-8.
        path.write_text(viewer_page(scene), encoding="utf-8", errors="replace")


def viewer_page(scene: SceneToWrite) -> str:
    """Return the page for one scene (batch 1); it opens at camera 0 and flies to any camera.

    Every Gaussian that can be drawn is in it. A switch shows the second look from the same place;
    one that is not called "before" shows its colours alike from all sides. A click on one of the
    objects chooses it, to hide it or all else. Where the scene has `uncertainty`, a slider hides
    what is less sure.
    """
    gaussians, cameras = scene.gaussians, scene.cameras
    assert cameras is not None  # they are needed
    if gaussians.means.shape[0] != 1 or cameras.c2w.shape[0] != 1:
        raise ValueError("a page shows one scene, got a batch")
    second = scene.second_look() if scene.second_look is not None else None
    before = second.colours if second is not None else None
    looks = second.names if second is not None else ("after", "before")
    # that objects are moved by shares of
    depth = float(gaussians.means[0, :, 2].median()) if gaussians.count else 1.0
    drawn = torch.nonzero(gaussians.opacities[0] >= LEAST_OPACITY)[:, 0]
    if len(drawn) > EASY_GAUSSIANS:
        warn(
            f"The viewer page holds {len(drawn):,} Gaussians and may be slow; --gaussians auto "
            "leaves fewer."
        )
    if before is not None:
        before = before[drawn.to(before.device)].cpu()
    gaussians = gaussians.select(drawn).to("cpu", torch.float32)
    cameras = cameras.to("cpu", torch.float64)
    facts, data = _pack(gaussians, cameras, before, scene.objects)
    distance = _typical_distance(gaussians, cameras)
    meta = {
        **facts,
        "distance": distance,
        "depth": depth,
        "near": 1e-3 * distance,
        "unit": scene.unit,
        "up": scene.up or up_direction(cameras.c2w[0]).tolist(),
        "views": _views(cameras, scene.names),
        "size": cameras.image_size,
        "first": looks[0],
        "second": looks[1],
        "title": scene.title or "edit3r scene",
        "subtitle": scene.subtitle,
    }
    # No text may end the script element.
    parts = {
        "TITLE": html.escape(scene.title or "edit3r scene"),
        "META": json.dumps(meta, allow_nan=False).replace("<", "\\u003c"),
        "DATA": base64.b64encode(data).decode("ascii"),
    }
    template = files(__package__).joinpath("viewer.html").read_text(encoding="utf-8")
    # In one pass: what a title says is never taken for a place to fill.
    return re.sub("__(TITLE|META|DATA)__", lambda place: parts[place[1]], template)


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
