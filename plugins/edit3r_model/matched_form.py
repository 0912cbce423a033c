"""The matched form: geometry from matching the unedited images, the edit from a small network.

    unedited images ──► matcher ──► poses, depths ──► backbone ──► features ──► head ──► Gaussians
    edited images ────────────────────────────────────────────────────────────┘
    ──► rim and background layer around and behind them

Every image pixel becomes one Gaussian, at the image's own resolution and sharpness.
"""

from dataclasses import replace
from math import lcm

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract import settings as config
from edit3r.contract.interfaces import Geometry
from edit3r.contract.settings import Share
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit import asking
from edit3r.kit.compute.layers import one_thread
from edit3r.kit.geometry.background_fill import background_layer, rim
from edit3r.kit.geometry.cameras import scale_poses
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.maps import resize, size_of
from edit3r_model.guesses import pushed_back
from edit3r_model.matched_unet import averaged
from edit3r_model.network import GaussianNetwork

ROUNDING = 1e-5
"""Differences of colour [sRGB] that come from turning colours into harmonics and back."""
GRID = 8
"""The network's images have sides that are multiples of this [pixels]."""


class MatchedSettings(config.Settings):
    """What counts where the head takes matched geometry."""

    network_size: int = Field(128, ge=32, le=256, multiple_of=8)
    """longer side of its grid [pixels]"""
    rim: Share = 0.12
    """width of the blurred rim that continues each photo [long sides]; 0: none"""
    rim_opacity: float = Field(0.6, gt=0, lt=1)
    """opacity of that rim"""
    background_layer: Share = 0.9
    """opacity of the blurred layer behind depth edges and guesses; 0: none"""


class MatchedForm:
    """Matched poses and depths, and a head that draws disagreeing edits to the reference's."""

    def __init__(self, settings: MatchedSettings, network: GaussianNetwork) -> None:
        self.settings = settings
        self.network = network

    def __call__(
        self,
        views: Views,
        source: Views,
        matched: Geometry,
        grid: tuple[int, int] | None,
    ) -> Reconstruction:
        """Reconstruct; in training mode differentiably, and the photos' own pixels alone."""
        grid = grid or views.image_size
        views, source = matched.calibrated(views), matched.calibrated(source)
        geometry = matched.at(grid)
        if self.network.training and torch.is_grad_enabled():
            reconstruction = self._of_pixels(views, source, geometry)
        else:
            # Silu, sigmoid and others round the last few values of what each thread is given in
            # another way.
            with one_thread(), torch.no_grad():
                geometry = pushed_back(geometry, source.intrinsics)
                reconstruction = self._of_pixels(views, source, geometry)
                coarse = views.at(grid), source.at(grid)
                reconstruction = self._with_background_fill(
                    reconstruction, *coarse, geometry
                )
        return replace(
            reconstruction, placed=geometry.registered, measured=matched.measured
        )

    def _of_pixels(
        self, views: Views, source: Views, geometry: Geometry
    ) -> Reconstruction:
        """One Gaussian a pixel of the geometry's grid; the views may be finer."""
        unit = geometry.depths[:, 0].flatten(1).median(1).values
        prior = _in_unit(geometry, unit)
        gaussians = self._gaussians(views, source, prior)
        # Back in the matcher's own unit; views that could not be placed are transparent.
        factor = unit[:, None, None]
        of_view = gaussians.view_index
        placed = geometry.registered[:, of_view] | (of_view < 0)
        gaussians = replace(
            gaussians,
            means=gaussians.means * factor,
            scales=gaussians.scales * factor,
            opacities=gaussians.opacities * placed,
        )
        c2w = scale_poses(prior.c2w, unit[:, None])
        size = size_of(prior.depths)
        cameras = Cameras(c2w, source.intrinsics, size)
        per_pixel = self.network.head.per_pixel
        return Reconstruction(gaussians, cameras, per_pixel=per_pixel)

    def _gaussians(self, views: Views, source: Views, prior: Geometry) -> Gaussians:
        """Backbone, then head."""
        backbone, head = self.network.backbone, self.network.head
        coarse = source.at(size_of(prior.depths))
        size = network_grid(
            coarse.image_size, self.settings.network_size, backbone.patch_size
        )
        images = resize(coarse.images, size)
        near = averaged(prior, size)
        features = asking.features(backbone, images, coarse.intrinsics, near)
        return asking.gaussians(head, features, views.images, source, prior)

    def _with_background_fill(
        self,
        reconstruction: Reconstruction,
        views: Views,
        source: Views,
        geometry: Geometry,
    ) -> Reconstruction:
        """Continue the fused images beyond their borders and behind their surfaces; say what
        fusing added.

        Where a pixel has several Gaussians, its colour is their mean; where they are not made pixel
        by pixel, the views' own colours count.
        """
        chosen, each = self.settings, reconstruction.per_pixel
        colours = views.images
        if each:
            shape = (*source.images.shape[:2], *source.image_size, each, 3)
            plain = dc_to_colour(reconstruction.gaussians.harmonics[:, :, 0])
            colours = plain.reshape(shape).mean(4).permute(0, 1, 4, 2, 3)
        fused = Views(colours, source.intrinsics)
        parts = [reconstruction.gaussians]
        if chosen.background_layer > 0:
            parts.append(background_layer(fused, geometry, chosen.background_layer))
        if chosen.rim > 0:
            parts.append(rim(fused, geometry, chosen.rim, chosen.rim_opacity))
        fusion = (colours - views.images).detach()
        fusion = torch.where(fusion.abs() > ROUNDING, fusion, 0.0)
        return replace(
            reconstruction,
            gaussians=Gaussians.cat(parts),
            fusion=fusion if fusion.any() else None,
        )


def network_grid(
    image_size: tuple[int, int], longest: int, patch_size: int
) -> tuple[int, int]:
    """(height, width) like the image's, the longer side `longest`, multiples of GRID and patch."""
    scale, unit = longest / max(image_size), lcm(GRID, patch_size)
    height, width = (max(2, round(side * scale / unit)) * unit for side in image_size)
    return height, width


def _in_unit(geometry: Geometry, unit: Float[Tensor, "batch"]) -> Geometry:
    """The geometry with `unit` as its unit of length."""
    factor = 1 / unit
    return replace(
        geometry,
        c2w=scale_poses(geometry.c2w, factor[:, None]),
        depths=geometry.depths * factor[:, None, None, None],
    )
