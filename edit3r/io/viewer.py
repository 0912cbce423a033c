"""The scene as one HTML page that opens from disk without a network: turn, enlarge and compare by
mouse or touch.

The page is ours (`viewer.html`, WebGL 2) because the ready-made exporters ask for a pinned web
server stack or Node. The same page serves the result's folder, notebooks and the app.
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
from jaxtyping import Float, UInt8
from torch import Tensor

from edit3r.contract.types import Cameras, Gaussians, Rendering, Views
from edit3r.geometry.cameras import project, to_pixels
from edit3r.geometry.harmonics import C1, C2, C3, C4, dc_to_colour
from edit3r.geometry.rotations import normalise_quats
from edit3r.io.atomic import atomic_write
from edit3r.io.ply import LEAST_OPACITY
from edit3r.reporting import warn

__all__ = ["colours_before", "save_viewer", "viewer_page"]

EASY_GAUSSIANS = (
    1_500_000  # six photos of 512 pixels; beyond it browsers get slow to sort
)
LEAST_STEP = 0.01  # of a harmonic: one of this size changes a colour by less than a step of 8 bits
SAME_DEPTH = 1.05  # what lies farther than so many times the depth seen is hidden
SAME_COLOUR, LIKE_COLOUR = (
    0.1,
    0.3,
)  # largest difference to the edited photo of what surely, likely shows there
NEARBY = 2  # how far from its pixel the colour of a Gaussian is looked for [pixels]
NEAREST = {"mode": "nearest", "padding_mode": "border", "align_corners": False}
LEVEL = 3  # of compression; higher ones save a twentieth and take three times as long


def save_viewer(
    path: str | Path, gaussians: Gaussians, cameras: Cameras, **texts: Any
) -> None:
    """Write the page of `viewer_page`, which explains the arguments."""
    page = viewer_page(gaussians, cameras, **texts)
    with atomic_write(path) as partial:
        partial.write_text(
            page, encoding="utf-8", errors="replace"
        )  # a file name in the title may be no UTF-8


def viewer_page(
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    names: Sequence[str] = (),
    title: str = "",
    subtitle: str = "",
    before: Float[Tensor, "gaussian 3"] | None = None,
) -> str:
    """Return the page for one scene (batch 1); it opens at camera 0 and flies to any camera.

    Every Gaussian that can be drawn is in it. `before` holds the colours (sRGB) of a second look
    that a switch shows from the same place, see `colours_before`.
    """
    if gaussians.means.shape[0] != 1 or cameras.c2w.shape[0] != 1:
        raise ValueError("save_viewer writes one scene, got a batch")
    drawn = torch.nonzero(gaussians.opacities[0] >= LEAST_OPACITY)[:, 0]
    if len(drawn) > EASY_GAUSSIANS:
        warn(
            f"The viewer page holds {len(drawn):,} Gaussians and may turn slowly; --gaussians "
            "auto leaves fewer."
        )
    before = before if before is None else before[drawn.to(before.device)].cpu()
    gaussians = gaussians.select(drawn).to("cpu", torch.float32)
    cameras = cameras.to("cpu", torch.float64)
    facts, data = _pack(gaussians, cameras, before)
    distance = _typical_distance(gaussians, cameras)
    meta = {
        **facts,
        "distance": distance,
        "near": 1e-3 * distance,
        "up": _up(cameras),
        "views": _views(cameras, names),
        "title": title,
        "subtitle": subtitle,
    }
    parts = {
        "TITLE": html.escape(title or "3D scene"),
        "META": json.dumps(meta, allow_nan=False).replace(
            "<", "\\u003c"
        ),  # no text may end the script element
        "DATA": base64.b64encode(data).decode("ascii"),
    }
    template = files("edit3r.io").joinpath("viewer.html").read_text(encoding="utf-8")
    # In one pass: what a title says is never taken for a place to fill.
    return re.sub("__(TITLE|META|DATA)__", lambda place: parts[place[1]], template)


def colours_before(
    gaussians: Gaussians,
    cameras: Cameras,
    photos: Views,
    edited: Views,
    rendered: Rendering,
) -> Float[Tensor, "gaussian 3"]:
    """Return the colours that the Gaussians of an edited scene would have without the edit (sRGB,
    one scene).

    To a Gaussian's colour comes the difference, photo less edited photo, of the pixel most like it
    in colour among the nine around its place, in the view it came from, or the first view that
    shows one of no view. What is like none of them (hidden things) keeps the colour it has: a
    stand-in, not the scene before the edit, whose shapes may have been others.
    """
    colours = dc_to_colour(gaussians.harmonics[0, :, 0])
    left = torch.ones_like(gaussians.view_index, dtype=torch.bool)
    for view in range(cameras.count):
        pixels, depths = project(
            gaussians.means[0], cameras.intrinsics[0, view], cameras.c2w[0, view]
        )
        values = torch.cat(
            (photos.images[:, view], edited.images[:, view], rendered.depths[:, view]),
            1,
        ).to(colours)
        least = torch.full_like(depths, torch.inf)
        change, depth = torch.zeros_like(colours), torch.zeros_like(colours[:, :1])
        for shift in torch.cartesian_prod(*[torch.arange(-1, 2)] * 2).to(pixels):
            grid = (
                2
                * (
                    pixels
                    + NEARBY * shift / pixels.new_tensor(cameras.image_size).flip(0)
                )
                - 1
            )
            found = torch.nn.functional.grid_sample(
                values, grid[None, None].to(colours), **NEAREST
            )[0, :, 0].T
            photo, edit, around = found.split((3, 3, 1), 1)
            gap = (colours - edit).abs().amax(-1)
            change = torch.where((gap < least)[:, None], photo - edit, change)
            least = torch.minimum(gap, least)
            depth = torch.maximum(depth, around)
        alike = (least < SAME_COLOUR) | (
            (depths < SAME_DEPTH * depth[:, 0]) & (least < LIKE_COLOUR)
        )
        inside = (pixels > 0).all(-1) & (pixels < 1).all(-1) & (depths > 0)
        mine = (
            alike
            & inside
            & left
            & ((gaussians.view_index == view) | (gaussians.view_index < 0))
        )
        colours = torch.where(mine[:, None], colours + change, colours)
        left = left & ~mine
    return colours


def _pack(
    gaussians: Gaussians, cameras: Cameras, before: Float[Tensor, "gaussian 3"] | None
) -> tuple[dict[str, Any], bytes]:
    """What the page must know to unpack the data, and the data: planes of one byte a Gaussian,
    compressed.

    Centres are directions (octahedral, 2 x 16 bits) and logarithmic distances (16 bits) from the
    middle of the cameras, so errors are small as the photos see them: 1/60 of a pixel at 512
    pixels. Colours, scales (logarithmic), opacities and quaternions have 8 bits, harmonics steps of
    0.01 where 8 bits reach. Neighbours in a photo are neighbours in the data: of what is alike
    there, differences are stored.
    """
    eye = cameras.c2w[0, :, :3, 3].mean(0).numpy()
    offsets = gaussians.means[0].double().numpy() - eye
    far = np.linalg.norm(offsets, axis=1).clip(1e-9)
    distances, distance_low, distance_step = _in_steps(np.log(far), 65535)
    plane = offsets / np.abs(offsets).sum(1, keepdims=True).clip(1e-12)
    folded = (1 - np.abs(plane[:, 1::-1])) * np.where(plane[:, :2] < 0, -1, 1)
    corners = np.where(plane[:, 2:] < 0, folded, plane[:, :2])
    centres = (
        np.column_stack(((corners + 1) * 32767.5, distances)).round().astype("<u2")
    )
    centres = np.diff(
        centres, axis=0, prepend=np.zeros((1, 3), "<u2")
    )  # wraps around, as all sums on the page do

    colours = dc_to_colour(gaussians.harmonics[0, :, 0]).clamp(-0.5, 1.5).numpy()
    low = min(0.0, float(colours.min(initial=0)))
    step = (max(1.0, float(colours.max(initial=1))) - low) / 255
    shown = ((colours - low) / step).round().astype(np.uint8)
    scales, scale_low, scale_step = _in_steps(
        gaussians.scales[0].clamp(min=1e-12).log().numpy(), 255
    )
    harmonics = gaussians.harmonics[0, :, 1:].flatten(1).numpy()
    harmonics_step = max(LEAST_STEP, float(np.abs(harmonics).max(initial=0)) / 127)
    planes = [
        centres & 255,
        centres >> 8,
        _differences(shown),
        (gaussians.opacities[0][:, None].numpy() * 255).round(),
        _differences(scales.round().astype(np.uint8)),
        (normalise_quats(gaussians.quats[0]) * 127)
        .round()
        .numpy()
        .astype(np.int8)
        .view(np.uint8),
    ]
    if before is not None:
        planes.append(
            ((before.clamp(-0.5, 1.5).numpy() - low) / step)
            .round()
            .clip(0, 255)
            .astype(np.uint8)
            - shown
        )
    planes.append((harmonics / harmonics_step).round().astype(np.int8).view(np.uint8))
    facts = {
        **{
            "count": gaussians.count,
            "degree": gaussians.degree,
            "before": before is not None,
            "eye": eye.tolist(),
        },
        **{
            "distanceLow": distance_low,
            "distanceStep": distance_step,
            "scaleLow": scale_low,
            "scaleStep": scale_step,
        },
        **{"colourLow": low, "colourStep": step, "harmonicsStep": harmonics_step},
        "factors": [-C1, C1, -C1, *C2, *C3, *C4],
    }
    data = b"".join(
        np.ascontiguousarray(part.astype(np.uint8).T).tobytes() for part in planes
    )
    return facts, zlib.compress(data, LEVEL)


def _in_steps(values: np.ndarray, levels: int) -> tuple[np.ndarray, float, float]:
    """The values in steps from their lowest, that lowest, and the step."""
    low, high = (
        (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    )
    step = max((high - low) / levels, 1e-9)
    return (values - low) / step, low, step


def _differences(
    rows: UInt8[np.ndarray, "gaussian column"],
) -> UInt8[np.ndarray, "gaussian column"]:
    return np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), np.uint8))


def _typical_distance(gaussians: Gaussians, cameras: Cameras) -> float:
    """Median distance along camera 0's axis of the visible Gaussians in front of it; 1 when there
    are none.
    """
    forward = cameras.c2w[0, 0, :3, 2].float()
    depths = (gaussians.means[0] - cameras.c2w[0, 0, :3, 3].float()) @ forward
    depths = depths[(depths > 0) & (gaussians.opacities[0] > 0.1)]
    return float(depths.median()) if len(depths) else 1.0


def _up(cameras: Cameras) -> list[float]:
    """Mean up direction of the cameras, which people hold upright."""
    up = -cameras.c2w[0, :, :3, 1].mean(0)
    if up.norm() < 0.1:  # held every way round: go by the first
        up = -cameras.c2w[0, 0, :3, 1]
    return (up / up.norm()).tolist()


def _views(cameras: Cameras, names: Sequence[str]) -> list[dict[str, Any]]:
    height, width = cameras.image_size
    pixels = to_pixels(cameras.intrinsics[0], cameras.image_size)
    return [
        {
            "name": names[index] if index < len(names) else f"view {index}",
            "c2w": cameras.c2w[0, index].tolist(),
            "lens": {
                "fx": float(k[0, 0]),
                "fy": float(k[1, 1]),
                "cx": float(k[0, 2]),
                "cy": float(k[1, 2]),
                "width": width,
                "height": height,
            },
        }
        for index, k in enumerate(pixels)
    ]
