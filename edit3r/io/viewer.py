"""The scene as one HTML page that opens from disk without a network: turn, move and zoom by mouse or touch.

The page is ours (`viewer.html`, WebGL 2) because the ready-made exporters ask for a pinned web server stack or Node.
It draws each Gaussian in the plain colour it has seen from the photo it came from; harmonics are not evaluated again.
"""

import base64
import html
import json
import re
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from edit3r.geometry.cameras import to_pixels
from edit3r.geometry.harmonics import basis
from edit3r.geometry.rotations import normalise_quats
from edit3r.io.atomic import atomic_write
from edit3r.io.ply import LEAST_OPACITY
from edit3r.reporting import warn
from edit3r.types import Cameras, Gaussians

__all__ = ["save_viewer"]

MOST_GAUSSIANS = 1_500_000  # about 46 MB of page: six photos of 512 pixels; beyond it browsers get slow to sort
SCALE_LEVELS = 255


def save_viewer(
    path: str | Path,
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    names: Sequence[str] = (),
    title: str = "",
    subtitle: str = "",
) -> None:
    """Write the page for one scene (batch 1); it opens at camera 0 and has a button for each camera.

    23 bytes a Gaussian before base64: float32 centres, scales in 255 steps of their logarithm, quaternions and colours
    of 8 bits. Above 1,500,000 Gaussians those that look largest are kept, and a warning says so.
    """
    if gaussians.means.shape[0] != 1 or cameras.c2w.shape[0] != 1:
        raise ValueError("save_viewer writes one scene, got a batch")
    shown = _shown(gaussians, cameras)
    gaussians = (gaussians if len(shown) == gaussians.count else gaussians.select(shown)).to("cpu", torch.float32)
    cameras = cameras.to("cpu", torch.float64)
    scale_low, scale_step, data = _pack(gaussians, cameras)
    distance = _typical_distance(gaussians, cameras)
    meta = {
        "count": gaussians.count,
        "scaleLow": scale_low,
        "scaleStep": scale_step,
        "distance": distance,
        "near": 1e-3 * distance,
        "up": _up(cameras),
        "views": _views(cameras, names),
        "title": title,
        "subtitle": subtitle,
    }
    parts = {
        "TITLE": html.escape(title or "3D scene"),
        "META": json.dumps(meta, allow_nan=False).replace("<", "\\u003c"),  # no text may end the script element
        "DATA": base64.b64encode(data).decode("ascii"),
    }
    template = files("edit3r.io").joinpath("viewer.html").read_text(encoding="utf-8")
    # In one pass: what a title says is never taken for a place to fill.
    page = re.sub("__(TITLE|META|DATA)__", lambda place: parts[place[1]], template)
    with atomic_write(path) as partial:
        partial.write_text(page, encoding="utf-8", errors="replace")  # a file name in the title may be no UTF-8


def _shown(gaussians: Gaussians, cameras: Cameras) -> Int[Tensor, "shown"]:
    """Indices of the Gaussians that go into the page, in their order."""
    opacities = gaussians.opacities[0]
    index = torch.nonzero(opacities >= LEAST_OPACITY)[:, 0]
    if len(index) > MOST_GAUSSIANS:
        # Opacity times the angular area of the largest face, as its own photo sees it. By the area in the scene's units
        # near surfaces would go first: their Gaussians are small.
        sizes = gaussians.scales[0, index].sort(-1, descending=True).values[:, :2].prod(-1)
        centres = cameras.c2w[0, _own_view(gaussians, cameras)[index], :3, 3].to(gaussians.means)
        distances = (gaussians.means[0, index] - centres).norm(dim=-1).clamp(min=1e-12)
        index = index[torch.topk(opacities[index] * sizes / distances**2, MOST_GAUSSIANS).indices].sort().values
        warn(f"The viewer shows {MOST_GAUSSIANS} of {gaussians.count} Gaussians; scene.ply has all.")
    return index


def _pack(gaussians: Gaussians, cameras: Cameras) -> tuple[float, float, bytes]:
    """Lowest log scale, its step, and the bytes: all centres, then all colours, scales and quaternions."""
    logs = gaussians.scales[0].clamp(min=1e-12).log()
    low, high = (float(logs.min()), float(logs.max())) if logs.numel() else (0.0, 0.0)
    step = max((high - low) / SCALE_LEVELS, 1e-9)
    quats = normalise_quats(gaussians.quats[0])
    colours = torch.cat((_seen_colours(gaussians, cameras), gaussians.opacities[0][:, None]), 1)
    parts = (
        gaussians.means[0].numpy().astype("<f4"),
        (colours.clamp(0, 1) * 255).round().numpy().astype(np.uint8),
        ((logs - low) / step).round().numpy().astype(np.uint8),
        (quats * 127).round().numpy().astype(np.int8),
    )
    return low, step, b"".join(part.tobytes() for part in parts)


def _seen_colours(gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "gaussian 3"]:
    """sRGB of each Gaussian as seen from the camera of its own view, camera 0 for those without one."""
    directions = gaussians.means[0] - cameras.c2w[0, _own_view(gaussians, cameras), :3, 3].float()
    directions = directions / directions.norm(dim=-1, keepdim=True).clamp(min=1e-12)
    values = basis(directions, gaussians.degree)  # [G, K]
    return torch.einsum("gk,gkc->gc", values, gaussians.harmonics[0]) + 0.5


def _own_view(gaussians: Gaussians, cameras: Cameras) -> Int[Tensor, "gaussian"]:
    """The view that each Gaussian came from; view 0 for one without."""
    return torch.where(gaussians.view_index < cameras.count, gaussians.view_index, 0).clamp(min=0)


def _typical_distance(gaussians: Gaussians, cameras: Cameras) -> float:
    """Median distance along camera 0's axis of the visible Gaussians in front of it; 1 when there are none."""
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
