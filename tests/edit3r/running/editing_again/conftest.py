"""The planted scene, its masks, and a small scene rasterizer."""

from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

import edit3r
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Reconstruction, Views
from edit3r.loading.load import load_plugins
from edit3r.loading.registry import Registry
from edit3r_testing.scenes import photograph

PLUGIN = Path(__file__).parent / "planted.py"


@dataclass(frozen=True)
class Planted:
    """Photos of two balls before a wall, and a mask around each ball."""

    views: Views
    masks: torch.Tensor  # [ball, 1, view, height, width]
    registry: Registry
    calls: list[str]

    def reconstruct(self, views: Views, **settings) -> Reconstruction:
        return self.registry.build("reconstructor", "planted", **settings)(
            views, source=self.views
        )


@pytest.fixture(scope="session")
def rasterizer() -> Rasterizer:
    return edit3r.build("rasterizer", "numba", threads=1)


@pytest.fixture(scope="session")
def registry() -> Registry:
    registry = Registry(load_plugins([PLUGIN]))
    registry.load_class(registry.find("matcher", "planted"))
    return registry


@pytest.fixture
def planted(registry) -> Planted:
    import planted as plugin

    plugin.CALLS.clear()
    scene = photograph(2, plugin.SIZE)
    grown = torch.nn.functional.max_pool2d(
        scene.objects[:, 0].flatten(0, 1)[:, None], 7, 1, 3
    )
    views = Views(
        (scene.views.images * 255).round() / 255,
        scene.views.intrinsics,
        ("left", "right"),
    )
    return Planted(
        views, grown[:, 0].unflatten(0, (2, 2))[:, None], registry, plugin.CALLS
    )
