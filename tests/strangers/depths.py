"""A stranger's rasterizer: depths and normals, and no images."""

import torch

from edit3r import Component, build, hookimpl
from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Rendering

EDIT3R_API = 1


class DepthsRasterizer(Rasterizer):
    gives = ("depths", "normals")

    def __init__(self, settings):
        self.torch = build("rasterizer", "torch")

    def render(self, gaussians, cameras):
        depths = self.torch.render(gaussians, cameras).depths
        slopes = torch.gradient(depths, dim=(-1, -2))
        normals = torch.cat((*slopes, -torch.ones_like(depths)), 2)
        normals = torch.nn.functional.normalize(normals, dim=2)
        return Rendering(depths=depths, extra={"normals": normals})


@hookimpl
def register_rasterizers():
    return Component("depths", "depths:DepthsRasterizer", "depths and normals alone")
