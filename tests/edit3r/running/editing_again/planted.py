"""A local plugin for these tests: a matcher that knows the scene of `edit3r_testing.scenes` and
counts its calls, a reconstructor of one Gaussian per pixel on it, and an editor that inverts
colours.
"""

import torch
from pydantic import Field

from edit3r import Component, hookimpl
from edit3r.contract import settings as config
from edit3r.contract.interfaces import Editor, Geometry, Matcher, Reconstructor
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit.cache import remembered
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
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
        cameras = Cameras(geometry.c2w, views.intrinsics, views.image_size)
        depths = geometry.depths
        scales = pixel_scales(depths, views.intrinsics, self.settings.footprint)
        opacities = torch.full_like(depths, 0.9)
        made = pixels_to_gaussians(views.images, depths, cameras, scales, opacities)
        return Reconstruction(made, cameras)


class InvertedEditor(Editor):
    class Settings(config.Settings):
        pass

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def edit(self, views: Views, request) -> Views:
        CALLS.append("edit")
        return Views(1 - views.images, views.intrinsics, views.names, views.c2w)
