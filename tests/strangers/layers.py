"""A stranger's head: three Gaussians of each pixel, one behind the other."""

import torch
from torch.nn.functional import pixel_shuffle, softplus

from edit3r import Component, Gaussians, hookimpl
from edit3r.contract.interfaces import GaussianHead
from edit3r.kit.geometry.cameras import pixel_rays
from edit3r.kit.geometry.harmonics import colour_to_dc

EDIT3R_API = 1


class LayersHead(GaussianHead):
    per_pixel = 3

    def __init__(self, settings, backbone):
        super().__init__()
        self.out = torch.nn.Linear(backbone.feature_widths[-1], 6 * 16**2)

    def forward(self, features, images, source, geometry):
        batch, views, _, height, width = images.shape
        raw = self.out(features.levels[-1]).mT.unflatten(-1, features.grid)
        raw = pixel_shuffle(raw, 16).movedim(2, -1)  # [B, V, H, W, 6]
        depth = 1 + softplus(raw[..., :3]).cumsum(-1)
        rays = pixel_rays(source.intrinsics, (height, width))[..., None, :]
        means = rays * depth[..., None]
        scales = (depth / width)[..., None].expand_as(means)
        quats = torch.eye(1, 4).expand(*depth.shape, 4)
        return Gaussians(
            *(x.reshape(batch, -1, x.shape[-1]) for x in (means, scales, quats)),
            raw[..., 3:].sigmoid().flatten(1),
            colour_to_dc(images.movedim(2, -1))
            .reshape(batch, -1, 1, 3)
            .repeat_interleave(3, 1),
            torch.arange(views).repeat_interleave(height * width * 3),
        )


@hookimpl
def register_heads():
    return Component("layers", "layers:LayersHead", "a stranger", parts=("backbone",))
