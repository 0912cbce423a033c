"""A local plugin for these tests: a matcher that knows the scene of `edit3r_testing.scenes` and
counts its calls, a reconstructor of one Gaussian per pixel on it, and an editor that inverts
colours.
"""

import torch
from pydantic import Field

from edit3r import Component, hookimpl
from edit3r.contract import settings as config
from edit3r.contract.interfaces import Editor, Geometry, Matcher, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.cache import remembered
from edit3r.kit.geometry.cameras import unproject
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r_testing.scenes import photograph

EDIT3R_API = 1
SIZE = (48, 64)
CALLS = []  # what was computed, in order


@hookimpl
def register_matchers():
    return [
        Component(
            name="planted",
            target="planted:PlantedMatcher",
            summary="knows the test scene",
        )
    ]


@hookimpl
def register_reconstructors():
    return [
        Component(
            name="planted",
            target="planted:PlantedReconstructor",
            summary="test scene",
        ),
    ]


@hookimpl
def register_editors():
    return [
        Component(
            name="inverted", target="planted:InvertedEditor", summary="inverts colours"
        )
    ]


class PlantedMatcher(Matcher):
    class Settings(config.Settings):
        depth: float = Field(1.0, gt=0, description="factor")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    @remembered
    def match(self, views: Views) -> Geometry:
        CALLS.append("match")
        scene = photograph(views.count, SIZE)
        depths = self.settings.depth * scene.depths
        registered = torch.ones(1, views.count, dtype=torch.bool)
        return Geometry(scene.cameras.c2w, depths, torch.ones_like(depths), registered)


class PlantedReconstructor(Reconstructor):
    class Settings(config.Settings):
        footprint: float = Field(0.4, gt=0, description="size of a Gaussian [pixels]")

    uses_geometry = True

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def __call__(
        self, views: Views, source: Views | None = None, geometry=None, grid=None
    ) -> Reconstruction:
        CALLS.append("reconstruct")
        means = unproject(geometry.depths, views.intrinsics, geometry.c2w).reshape(
            1, -1, 3
        )
        focal = views.intrinsics[0, 0, 0, 0] * views.image_size[1]
        scales = (
            (self.settings.footprint * geometry.depths / focal)
            .reshape(1, -1, 1)
            .expand(1, -1, 3)
        )
        gaussians = Gaussians(
            means,
            scales.contiguous(),
            torch.tensor([1.0, 0, 0, 0]).repeat(1, means.shape[1], 1),
            torch.full(means.shape[:2], 0.9),
            colour_to_dc(views.images.permute(0, 1, 3, 4, 2).reshape(1, -1, 1, 3)),
            torch.arange(views.count).repeat_interleave(SIZE[0] * SIZE[1]),
        )
        return Reconstruction(
            gaussians, Cameras(geometry.c2w, views.intrinsics, views.image_size)
        )


class InvertedEditor(Editor):
    class Settings(config.Settings):
        pass

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def edit(self, views: Views, request) -> Views:
        CALLS.append("edit")
        return Views(1 - views.images, views.intrinsics, views.names, views.c2w)
