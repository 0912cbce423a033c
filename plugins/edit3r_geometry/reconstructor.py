"""The reconstructor `classical`: measured depth, one Gaussian a pixel."""

from itertools import permutations

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.interfaces import Geometry, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.checks import require_geometry
from edit3r.kit.geometry.background_fill import background_layer, rim
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians, unproject
from edit3r.kit.geometry.warping import contradicted, seen_by


class ClassicalReconstructor(Reconstructor):
    """Geometry from the unedited photos, colours from the edited ones.

    Pixels whose depth was guessed are less opaque, and left out where another view measured the
    same surface or sees through them.
    """

    class Settings(edit3r.Settings):
        footprint: float = Field(0.35, gt=0, le=4)
        """standard deviation of a Gaussian [pixels of its view]"""
        opacity: float = Field(0.6, gt=0, le=1)
        """opacity where two views measured the depth"""
        guessed_opacity: float = Field(0.45, ge=0, le=1)
        """opacity where the depth was filled in"""
        lone_opacity: float = Field(0.8, ge=0, le=1)
        """opacity of filled-in pixels whose place no other photo shows"""
        rim: float = Field(0.12, ge=0, le=1)
        """width of the blurred rim that continues each photo [long sides]; 0: none"""

        background_layer: float = Field(0.9, ge=0, le=1)
        """opacity of the blurred layer behind depth edges and guesses; 0: none"""

    settings: Settings

    uses_geometry = True

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        geometry = require_geometry(self, geometry)
        grid = grid or views.image_size
        measured = geometry.measured
        views = geometry.calibrated(views).at(grid)
        geometry = geometry.at(grid)
        chosen = self.settings
        guessed = torch.where(
            seen_by_others(geometry, views.intrinsics),
            chosen.guessed_opacity,
            chosen.lone_opacity,
        )
        opacities = guessed + (chosen.opacity - guessed) * geometry.confidence
        kept = geometry.registered[..., None, None] & ~contradicted(
            geometry, views.intrinsics
        )
        cameras = Cameras(geometry.c2w, views.intrinsics, views.image_size)
        scales = pixel_scales(geometry.depths, views.intrinsics, chosen.footprint)
        gaussians = pixels_to_gaussians(
            views.images, geometry.depths, cameras, scales, opacities * kept
        )
        gaussians = gaussians.select((gaussians.opacities > 0).any(dim=0))
        if chosen.background_layer > 0:
            gaussians = Gaussians.cat(
                (gaussians, background_layer(views, geometry, chosen.background_layer))
            )
        if chosen.rim > 0:
            gaussians = Gaussians.cat(
                (gaussians, rim(views, geometry, chosen.rim, chosen.guessed_opacity))
            )
        return Reconstruction(gaussians, cameras, geometry.registered, measured)


def seen_by_others(
    geometry: Geometry, intrinsics: Float[Tensor, "batch view 3 3"]
) -> Bool[Tensor, "batch view height width"]:
    """Pixels whose point lies within the image of another registered view, hidden there or not."""
    points = unproject(geometry.depths, intrinsics, geometry.c2w).flatten(2, 3)
    seen = torch.zeros(points.shape[:3], dtype=torch.bool, device=points.device)
    for view, other in permutations(range(points.shape[1]), 2):
        seen[:, view] |= seen_by(points[:, view], geometry, intrinsics, other)
    return seen.view(geometry.depths.shape)
