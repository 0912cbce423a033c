"""Pictures and depths of a fitted scene from the views' own cameras."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import MatchedGeometry, Matcher, Rasterizer
from edit3r.types import Cameras, Gaussians, Views

__all__ = ["FittedGeometry", "depths_of", "rendered"]

COVERED = 0.5
"""Alpha from which a pixel's depth is the scene's."""


@torch.no_grad()
def rendered(gaussians: Gaussians, cameras: Cameras, photos: Views, rasterizer: Rasterizer) -> Views:
    """The views as the fitted scene shows them."""
    return replace(photos, images=rasterizer.render(gaussians, cameras).images.clamp(0, 1), c2w=cameras.c2w)


@torch.no_grad()
def depths_of(
    gaussians: Gaussians, cameras: Cameras, rasterizer: Rasterizer
) -> tuple[Float[Tensor, "view height width"], Float[Tensor, "view height width"]]:
    """Camera z of every pixel of one scene, and its alpha; where nothing is hit, the farthest depth of that view."""
    seen = rasterizer.render(gaussians, cameras)
    depths, alphas = seen.depths[0, :, 0], seen.alphas[0, :, 0]
    farthest = depths.amax((1, 2), keepdim=True).clamp(min=1e-6)
    return torch.where(depths > 0, depths, farthest), alphas


class FittedGeometry(Matcher):
    """Poses and depths of a fitted scene, for components that ask a matcher; it matches nothing."""

    def __init__(self, cameras: Cameras, depths: Tensor, alphas: Tensor) -> None:
        self.cameras, self.depths, self.alphas = cameras, depths, alphas

    def match(self, views: Views) -> MatchedGeometry:
        """Of the views it was made for, whatever their pictures."""
        registered = torch.ones(1, self.cameras.count, dtype=torch.bool, device=self.depths.device)
        confidence = (self.alphas > COVERED).to(self.depths)
        return MatchedGeometry(self.cameras.c2w, self.depths[None], confidence[None], registered)
