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
        views, _, height, width = images.shape[1:]
        raw = self.out(features.levels[-1]).mT.unflatten(-1, features.grid)
        raw = pixel_shuffle(raw, 16).movedim(2, -1)  # [B, V, H, W, 6]
        depth = (1 + softplus(raw[..., :3]).cumsum(-1))[..., None]
        means = depth * pixel_rays(source.intrinsics, (height, width))[..., None, :]
        scales = (depth / width).expand_as(means)
        quats = torch.eye(1, 4).expand(*depth.shape[:-1], 4)
        harmonics = colour_to_dc(images.movedim(2, -1)).flatten(1, 3)[:, :, None]
        return Gaussians(
            *(x.flatten(1, 4) for x in (means, scales, quats)),
            raw[..., 3:].sigmoid().flatten(1),
            harmonics.repeat_interleave(3, 1),
            torch.arange(views).repeat_interleave(height * width * 3),
        )


@hookimpl
def register_heads():
    return Component("layers", "layers:LayersHead", "a stranger", parts=("backbone",))
