"""A plugin for tests: a reconstructor and a matcher that put every pixel on one plane, for runs
that take no time.
"""

import torch

from edit3r import Cameras, Component, Reconstruction, hookimpl
from edit3r.contract.interfaces import Geometry, Matcher, Reconstructor
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians


@hookimpl
def register_reconstructors():
    return Component(
        "flat", "flat_scene:FlatReconstructor", "test stand-in: the photos on one plane"
    )


@hookimpl
def register_matchers():
    return Component(
        "flat",
        "flat_scene:FlatMatcher",
        "test stand-in: depth grows from left to right",
    )


class FlatReconstructor(Reconstructor):
    """One Gaussian for every pixel of view 0 at depth 1; all cameras at the origin."""

    min_views = 1

    def __init__(self, settings):
        self.settings = settings

    def __call__(self, views, source=None, geometry=None, grid=None):
        poses = torch.eye(4).expand(*views.images.shape[:2], 4, 4)
        cameras = Cameras(poses, views.intrinsics, views.image_size)
        first = cameras.select([0])
        ones = torch.ones_like(views.images[:, :1, 0])
        scales = pixel_scales(ones, first.intrinsics, 0.5)
        made = (views.images[:, :1], ones, first, scales, 0.9 * ones)
        return Reconstruction(pixels_to_gaussians(*made), cameras)


class FlatMatcher(Matcher):
    """No motion; depth from 1 at the left edge to 4 at the right."""

    def __init__(self, settings):
        self.settings = settings

    def match(self, views):
        batch, count = views.images.shape[:2]
        height, width = views.image_size
        depths = torch.linspace(1, 4, width).expand(batch, count, height, width)
        poses = torch.eye(4).expand(batch, count, 4, 4)
        return Geometry(
            poses,
            depths,
            torch.ones_like(depths),
            torch.ones(batch, count, dtype=torch.bool),
        )
