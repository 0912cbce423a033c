"""A benchmark of one generated scene at 48 pixels, and a reconstructor quick enough to run it many
times.
"""

import pytest
from edit3r_bench.generated import GeneratedSettings, build_generated
from edit3r_bench.manifest import write_bench_manifest

from edit3r.loading.registry import default_registry

CARDS = '''
"""Local plugin: every view a flat card of Gaussians at the known poses. Quick, and wrong."""

import torch

from edit3r import Component, hookimpl
from edit3r.contract.settings import Settings
from edit3r.contract.errors import MatchingError
from edit3r.kit.geometry.cameras import unproject
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.contract.interfaces import Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction

EDIT3R_API = 1


class Cards(Reconstructor):
    class Settings(Settings):
        depth: float = 2.9  # in mean distances of the other cameras from the first
        fails: bool = False

    def __init__(self, settings):
        self.settings = settings

    def __call__(self, views, source=None, geometry=None, grid=None):
        if self.settings.fails:
            raise MatchingError("the cards fell over.")
        places = views.c2w[:, :, :3, 3]  # in a unit of the run's own choosing
        depth = self.settings.depth * float((places - places[:, :1])[:, 1:].norm(dim=-1).mean())
        depths = torch.full((*views.images.shape[:2], *views.image_size), depth)
        points = unproject(depths, views.intrinsics, views.c2w).flatten(1, 3)
        colours = views.images.permute(0, 1, 3, 4, 2).flatten(1, 3)
        count = points.shape[1]
        size = depth / views.image_size[1]
        quats = torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4)
        opacities = torch.full((1, count), 0.9)
        scales, harmonics = torch.full((1, count, 3), size), colour_to_dc(colours)[:, :, None]
        view = torch.arange(views.count).repeat_interleave(count // views.count)
        gaussians = Gaussians(points, scales, quats, opacities, harmonics, view)
        return Reconstruction(gaussians, Cameras(views.c2w, views.intrinsics, views.image_size))


@hookimpl
def register_reconstructors():
    target = f"{__name__}:Cards"
    return [Component(name="cards", target=target, summary="flat cards at the known poses")]
'''


@pytest.fixture(scope="session")
def small():
    """Settings of tiny generated scenes."""
    return GeneratedSettings(image_size=48, seed=3)


@pytest.fixture(scope="session")
def manifest(small):
    return build_generated(1, small, default_registry())


@pytest.fixture(scope="session")
def manifest_file(manifest, tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "bench.json"
    write_bench_manifest(path, manifest)
    return path


@pytest.fixture(scope="session")
def cards(tmp_path_factory):
    """Plugin file that offers the reconstructor `cards`."""
    path = tmp_path_factory.mktemp("plugin") / "cards.py"
    path.write_text(CARDS, encoding="utf-8")
    return str(path)
