"""Rendering many cameras, one by one, held to the rasterizer's contract; numbers of Gaussians as
maps; and the flight around a scene.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.interfaces.writing import Frame
from edit3r.contract.reporting import track
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.kit import asking
from edit3r.kit.checks import errors_named_after
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.geometry.paths import between_and_around
from edit3r.kit.photos.images import save_pixels, to_bytes


def render_each(
    rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras, text: str
) -> Rendering:
    """Render camera by camera, showing progress under `text`."""
    whole: dict[str, Tensor] = {}
    for i in track(range(cameras.count), text):
        one = asking.render(rasterizer, gaussians, cameras.select([i]))
        for name, part in one.given.items():
            if i == 0:  # each part goes where it stays: parts and their whole are twice
                batch, _, *shape = part.shape
                whole[name] = part.new_empty(batch, cameras.count, *shape)
            whole[name][:, i] = part[:, 0]
    return Rendering.of(whole)


class CheckedRasterizer(Rasterizer):
    """A rasterizer each of whose answers is checked."""

    def __init__(self, rasterizer: Rasterizer) -> None:
        self.rasterizer, self.gives = rasterizer, rasterizer.gives
        for name in ("settings", "offer", "parts"):
            if hasattr(rasterizer, name):
                setattr(self, name, getattr(rasterizer, name))

    def prepare(self, device: str) -> None:
        self.rasterizer.prepare(device)

    def render(self, gaussians: Gaussians, cameras: Cameras) -> Rendering:
        return asking.render(self.rasterizer, gaussians, cameras)

    def contributions(
        self,
        gaussians: Gaussians,
        cameras: Cameras,
        weights: Float[Tensor, "camera *map height width"] | None = None,
    ) -> Float[Tensor, "batch gaussian *map"]:
        own = type(self.rasterizer).contributions is not Rasterizer.contributions
        if not own:  # each picture that it is read from is checked
            return super().contributions(gaussians, cameras, weights)
        with errors_named_after(self.rasterizer):
            return self.rasterizer.contributions(gaussians, cameras, weights)


class OverBackground(CheckedRasterizer):
    """A rasterizer whose pictures stand before a grey background, in [0, 1]."""

    def __init__(self, rasterizer: Rasterizer, background: float) -> None:
        super().__init__(rasterizer)
        self.background = background

    def render(self, gaussians: Gaussians, cameras: Cameras) -> Rendering:
        rendering = super().render(gaussians, cameras)
        images = rendering.images + (1 - rendering.alphas) * self.background
        return replace(rendering, images=images)


def render_numbers(
    rasterizer: Rasterizer,
    gaussians: Gaussians,
    numbers: Float[Tensor, "batch gaussian"],
    cameras: Cameras,
) -> Rendering:
    """Render with a number >= 0 of each Gaussian, in all three channels, in place of its colour."""
    colours = numbers.to(gaussians.means)[..., None, None].expand(-1, -1, 1, 3)
    grey = replace(gaussians, harmonics=colour_to_dc(colours).contiguous())
    return rasterizer.render(grey, cameras)


def path_around(cameras: Cameras, rendered: Rendering, frames: int) -> Cameras:
    """A camera path around `cameras`, whose swing is bounded by the depth of what they show."""
    # Indexing by a mask makes five whole numbers of each pixel first.
    seen = torch.masked_select(rendered.depths, rendered.alphas > 0.5)
    return between_and_around(
        cameras, frames, float(seen.median()) if seen.numel() else None
    )


@dataclass
class Flight:
    """A camera path through one scene. Each call draws it anew, while frames are taken."""

    rasterizer: Rasterizer
    gaussians: Gaussians
    path: Cameras
    # where pictures of the frames are left, by whoever takes them first; None: nowhere, or there
    pictures: Path | None = None

    def __call__(self) -> Iterator[Frame]:
        for index in track(range(self.path.count), "render camera path"):
            camera = self.path.select([index])
            rendering = asking.render(self.rasterizer, self.gaussians, camera)
            frame = to_bytes(rendering.images[0, 0])
            if self.pictures is not None:
                save_pixels(frame, self.pictures / f"path_{index:04d}.png")
            yield frame
        self.pictures = None

    def leave_pictures(self) -> None:
        """Draw the pictures that nobody drew yet."""
        if self.pictures is not None:
            deque(self(), maxlen=0)
