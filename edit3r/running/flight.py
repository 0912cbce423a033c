"""The flight around a scene, drawn frame by frame."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.interfaces.writing import Frame
from edit3r.contract.reporting import track
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.photos.images import save_pixels, to_bytes
from edit3r.running.rendering import render_one


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
            rendering = render_one(self.rasterizer, self.gaussians, camera)
            frame = to_bytes(rendering.images[0, 0])
            if self.pictures is not None:
                save_pixels(frame, self.pictures / f"path_{index:04d}.png")
            yield frame
        self.pictures = None

    def leave_pictures(self) -> None:
        """Draw the pictures that nobody drew yet."""
        if self.pictures is not None:
            deque(self(), maxlen=0)
