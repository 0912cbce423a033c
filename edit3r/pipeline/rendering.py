"""Rendering many cameras, one by one, held to the rasterizer's contract; and the camera path of a
run.
"""

import torch

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.geometry.paths import between_and_around
from edit3r.pipeline.checks import check_rendering, errors_named_after
from edit3r.reporting import track


def render_each(
    rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras, text: str
) -> Rendering:
    """Render camera by camera, showing progress under `text`."""
    parts = [
        render_one(rasterizer, gaussians, cameras.select([i]))
        for i in track(range(cameras.count), text)
    ]
    return Rendering(
        *(
            torch.cat([getattr(p, name) for p in parts], 1)
            for name in ("images", "alphas", "depths")
        )
    )


def render_one(
    rasterizer: Rasterizer, gaussians: Gaussians, camera: Cameras
) -> Rendering:
    """Render one camera and check the answer."""
    with errors_named_after(rasterizer):
        rendering = rasterizer.render(gaussians, camera)
    check_rendering(rasterizer, gaussians, camera, rendering)
    return rendering


def path_around(cameras: Cameras, rendered: Rendering, frames: int) -> Cameras:
    """A camera path between and around `cameras`, whose swing is bounded by the depth of what they
    show.
    """
    seen = rendered.depths[rendered.alphas > 0.5]
    return between_and_around(
        cameras, frames, float(seen.median()) if seen.numel() else None
    )
