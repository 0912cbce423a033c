"""A plugin for tests: a reconstructor and a matcher that put every pixel on one plane, for runs
that take no time.
"""

import torch

from edit3r import Cameras, Component, Gaussians, Reconstruction, hookimpl
from edit3r.contract.interfaces import Geometry, Matcher, Reconstructor


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
        images = views.images
        batch, count = images.shape[:2]
        height, width = views.image_size
        y, x = torch.meshgrid(
            torch.linspace(-0.5, 0.5, height),
            torch.linspace(-0.5, 0.5, width),
            indexing="ij",
        )
        means = (
            torch.stack((x, y, torch.ones_like(x)), -1)
            .view(1, -1, 3)
            .expand(batch, -1, -1)
        )
        total = means.shape[1]
        gaussians = Gaussians(
            means=means,
            scales=torch.full((batch, total, 3), 0.5 / max(height, width)),
            quats=torch.tensor([1.0, 0, 0, 0]).expand(batch, total, 4),
            opacities=torch.full((batch, total), 0.9),
            harmonics=((images[:, 0] - 0.5) / 0.2820948).flatten(2).mT[:, :, None],
            view_index=torch.zeros(total, dtype=torch.int64),
        )
        return Reconstruction(
            gaussians,
            Cameras(
                torch.eye(4).expand(batch, count, 4, 4),
                views.intrinsics,
                (height, width),
            ),
        )


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
