"""A stranger's backbone: it predicts the views' poses, and hands a camera token on."""

import torch

from edit3r import Component, hookimpl
from edit3r.contract.interfaces import Backbone
from edit3r.contract.types import Cameras, Features

EDIT3R_API = 1


class PosesBackbone(Backbone):
    patch_size, feature_widths = 16, (8,)

    def __init__(self, settings):
        super().__init__()
        self.patches = torch.nn.Conv2d(3, 8, 16, 16)
        self.step = torch.nn.Parameter(torch.tensor([0.25, 0.0, 0.0]))

    def forward(self, images, intrinsics, geometry=None):
        batch, views, _, *size = images.shape
        maps = self.patches(images.flatten(0, 1))
        tokens = maps.flatten(2).transpose(1, 2).unflatten(0, (batch, views))
        places = torch.arange(views)[:, None] * self.step
        c2w = torch.eye(4).repeat(batch, views, 1, 1)
        c2w[:, :, :3, 3] = places
        return Features(
            (tokens,),
            tuple(maps.shape[-2:]),
            cameras=Cameras(c2w, intrinsics, tuple(size)),
            tokens={"camera": tokens.mean(2, keepdim=True)},
        )


@hookimpl
def register_backbones():
    return Component(
        "poses", "posed_backbone:PosesBackbone", "poses of its own", min_views=2
    )
