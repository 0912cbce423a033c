"""A reconstructor with a network: any backbone, and a head of its own.

Untrained, it shows the photos on curtains.
"""

from dataclasses import replace

import torch
import torch.nn.functional as F
from pydantic import Field
from torch import nn

import edit3r
from edit3r import Component, PartChoice, hookimpl
from edit3r.contract.interfaces import GaussianHead, Reconstructor
from edit3r.contract.types import Gaussians, Reconstruction
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.weights.files import load_weights

EDIT3R_API = 1
SMALL = {
    "width": 64,
    "depth": 4,
    "heads": 2,
    "decoder_width": 48,
    "decoder_depth": 4,
    "decoder_heads": 2,
}


class CurtainHead(GaussianHead):
    """A depth and an opacity per pixel.

    The centre lies on the pixel's ray through a lens of focal length 1.
    """

    class Settings(edit3r.Settings):
        depth: float = Field(
            2.0, gt=0, description="depth it starts from [scene units]"
        )
        seed: int = Field(0, ge=0, description="of the initial weights")

    settings: Settings

    def __init__(self, settings, backbone):
        super().__init__()
        self.settings, self.patch_size = settings, backbone.patch_size
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.out = nn.Linear(backbone.feature_widths[-1], 2 * self.patch_size**2)

    def forward(self, features, images, source, geometry):
        batch, views, _, height, width = images.shape
        raw = (
            self.out(features.levels[-1]).transpose(-1, -2).unflatten(-1, features.grid)
        )
        depth, opacity = F.pixel_shuffle(raw, self.patch_size).unbind(2)  # [B, V, H, W]
        depth = self.settings.depth * (0.1 * depth.tanh()).exp()
        # [H, W, 3]
        rays = F.pad(pixel_grid((height, width), images) - 0.5, (0, 1), value=1.0)
        rays = rays * rays.new_tensor([1, height / width, 1])
        flat = (batch, views * height * width)
        return Gaussians(
            means=(rays * depth[..., None]).reshape(*flat, 3),
            scales=(depth / width)[..., None].expand(*depth.shape, 3).reshape(*flat, 3),
            quats=depth.new_tensor([1, 0, 0, 0]).expand(*flat, 4),
            opacities=opacity.sigmoid().reshape(flat),
            harmonics=colour_to_dc(images.movedim(2, -1)).reshape(*flat, 1, 3),
            view_index=torch.arange(views, device=images.device).repeat_interleave(
                height * width
            ),
        )


class LearnedReconstructor(Reconstructor):
    """Predicts no poses, so the pipeline finds them by PnP on the Gaussians."""

    class Settings(edit3r.Settings):
        backbone: PartChoice = Field(
            PartChoice(name="asymmetric-vit", settings=SMALL),
            description="views to features",
        )
        head: PartChoice = Field(
            PartChoice(name="curtain"), description="features to Gaussians"
        )
        size: int = Field(
            128, ge=32, le=512, description="longer side the network works at [pixels]"
        )
        weights: str | None = Field(
            None, description="folder best of `edit3r train`; default: untrained"
        )

    settings: Settings

    def __init__(self, settings, backbone, head):
        self.settings = settings
        self._network = nn.ModuleDict({"backbone": backbone, "head": head}).eval()
        if settings.weights is not None:
            load_weights(self._network, settings.weights)

    @property
    def network(self):
        return self._network

    def __call__(self, views, source=None, geometry=None, grid=None):
        patch = self.network["backbone"].patch_size
        scale = self.settings.size / max(views.image_size)
        fitting = [
            max(1, round(side * scale / patch)) * patch for side in views.image_size
        ]
        images = F.interpolate(
            views.images.flatten(0, 1), fitting, mode="bilinear", antialias=True
        )
        images = images.unflatten(0, views.images.shape[:2])
        # normalised: resizing changes nothing
        features = self.network["backbone"](images, views.intrinsics)
        head, views = self.network["head"], replace(views, images=images)
        gaussians = head(features, images, views, None)
        return Reconstruction(gaussians, features.cameras, per_pixel=head.per_pixel)


@hookimpl
def register_reconstructors():
    target = "learned:LearnedReconstructor"
    return [
        Component(
            "learned",
            target,
            "a small network",
            parts=("backbone", "head"),
            min_views=2,
        )
    ]


@hookimpl
def register_heads():
    return [
        Component(
            "curtain",
            "learned:CurtainHead",
            "a depth per pixel",
            parts=("backbone",),
            min_views=2,
        )
    ]
