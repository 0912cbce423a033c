"""A plugin for tests: a stranger's head, which takes no geometry."""

import torch

from edit3r import Component, hookimpl
from edit3r.contract.interfaces import GaussianHead
from edit3r.contract.settings import Settings
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r.kit.geometry.harmonics import colour_to_dc

EDIT3R_API = 1


class WallHead(GaussianHead):
    """The reference's image on a wall, once for each view; the features make it more opaque."""

    class Settings(Settings):
        depth: float = 2.0

    def __init__(self, settings, backbone):
        super().__init__()
        self.settings = settings
        self.out = torch.nn.Linear(backbone.feature_widths[-1], 1)

    def forward(self, features, images, source, geometry):
        batch, views, _, height, width = images.shape
        count = views * height * width
        more = self.out(features.levels[-1]).mean((1, 2, 3)).sigmoid()[:, None]
        rays = torch.nn.functional.pad(
            pixel_grid((height, width), images) - 0.5, (0, 1), value=1
        )
        means = self.settings.depth * rays.expand(batch, views, -1, -1, -1)
        reference = images[:, :1].expand_as(images).movedim(2, -1)
        return Gaussians(
            means=means.reshape(batch, count, 3),
            scales=torch.full((batch, count, 3), self.settings.depth / width),
            quats=torch.tensor([1.0, 0, 0, 0]).expand(batch, count, 4),
            opacities=(0.9 + 0.05 * more).expand(batch, count),
            harmonics=colour_to_dc(reference).reshape(batch, count, 1, 3),
            view_index=torch.arange(views).repeat_interleave(height * width),
        )


@hookimpl
def register_heads():
    head = "a stranger's head"
    return Component("wall", "plain_head:WallHead", head, parts=("backbone",))
