"""A stranger's head: one disc of each pixel, with two scales, as 2DGS has them."""

import torch
from torch.nn.functional import normalize, pixel_shuffle, softplus

from edit3r import Component, Gaussians, hookimpl
from edit3r.contract.interfaces import GaussianHead
from edit3r.kit.geometry.cameras import pixel_rays
from edit3r.kit.geometry.harmonics import colour_to_dc

EDIT3R_API = 1


class SurfelsHead(GaussianHead):
    def __init__(self, settings, backbone):
        super().__init__()
        self.patch_size = backbone.patch_size
        self.out = torch.nn.Linear(backbone.feature_widths[-1], 8 * self.patch_size**2)

    def forward(self, features, images, source, geometry):
        views, _, height, width = images.shape[1:]
        raw = self.out(features.levels[-1]).mT.unflatten(-1, features.grid)
        raw = pixel_shuffle(raw, self.patch_size).movedim(2, -1)  # [B, V, H, W, 8]
        depth, opacity, scales, turn = raw.split((1, 1, 2, 4), -1)
        depth = 1 + softplus(depth)
        return Gaussians(
            (pixel_rays(source.intrinsics, (height, width)) * depth).flatten(1, 3),
            (softplus(scales) * depth / width).flatten(1, 3),
            normalize(turn + torch.eye(1, 4) * 9, dim=-1).flatten(1, 3),
            opacity.sigmoid().flatten(1),
            colour_to_dc(images.movedim(2, -1)).flatten(1, 3)[:, :, None],
            torch.arange(views).repeat_interleave(height * width),
        )


@hookimpl
def register_heads():
    return Component(
        "surfels", "surfels:SurfelsHead", "a stranger", parts=("backbone",)
    )
