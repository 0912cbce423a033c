"""A small scene of which everything is known, and a reconstructor that knows it."""

from dataclasses import replace

import pytest
import torch

import edit3r
from edit3r.contract.interfaces import Editor, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import unproject
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r_testing.scenes import Photographed, photograph

SIZE = (32, 40)


class TrueDepth(Reconstructor):
    """Stand-in for a matcher's work: every few pixels a grey Gaussian where the photographed scene
    really is.
    """

    def __init__(self, every: int = 2) -> None:
        self.every = every

    def __call__(self, views, source=None, geometry=None, grid=None):
        truth = photograph(views.count, views.image_size)
        cut = (..., slice(None, None, self.every), slice(None, None, self.every))
        height, width = truth.depths[cut].shape[-2:]
        points = unproject(truth.depths, truth.cameras.intrinsics, truth.cameras.c2w)[0]
        points = points[:, :: self.every, :: self.every].reshape(1, -1, 3)
        sizes = 0.5 * self.every * truth.depths[cut] / views.image_size[1]
        sizes = sizes.reshape(1, -1, 1)
        quats = torch.zeros(*points.shape[:2], 4)
        quats[..., 0] = 1
        origin = torch.arange(views.count).repeat_interleave(height * width)
        grey = colour_to_dc(torch.full((1, points.shape[1], 1, 3), 0.5))
        opacities = torch.full(points.shape[:2], 0.8)
        scene = Gaussians(points, sizes.repeat(1, 1, 3), quats, opacities, grey, origin)
        batch = len(views.images)
        c2w = truth.cameras.c2w.repeat_interleave(batch, 0)
        cameras = Cameras(c2w, views.intrinsics, views.image_size)
        return Reconstruction(Gaussians.stack([scene] * batch), cameras)


class CountingEditor(Editor):
    """Inverts the colours and remembers what it was asked."""

    def __init__(self):
        self.calls = []

    def edit(self, views, request):
        self.calls.append((views, request))
        return replace(views, images=1 - views.images)


@pytest.fixture(scope="session")
def truth() -> Photographed:
    return photograph(3, SIZE)


@pytest.fixture(scope="session")
def posed(truth) -> Views:
    """The photos with their poses."""
    return replace(truth.views, c2w=truth.cameras.c2w)


@pytest.fixture(scope="session")
def rasterizer():
    return edit3r.build("rasterizer", "numba")


@pytest.fixture
def editor() -> CountingEditor:
    return CountingEditor()


@pytest.fixture
def build(rasterizer, editor):
    """A method by name, quick: true depths to begin with, the counting editor, few steps."""

    def build(name: str, parts=(), **settings):
        own = {"reconstructor": TrueDepth(), "editor": editor, "rasterizer": rasterizer}
        quick = {"steps": 6, "edit_steps": 6}
        return edit3r.build(
            "reconstructor", name, own | dict(parts), **quick | settings
        )

    return build
