"""A scene's uncertainty as a map, with every rasterizer that runs on a CPU."""

from dataclasses import replace

import pytest
import torch
from edit3r_uncertainty.api import render_uncertainty

from edit3r import Cameras, build
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians

CAMERA = Cameras(
    torch.eye(4)[None, None],
    torch.tensor([[[[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]]]),
    (24, 24),
)


@pytest.fixture
def wall():
    """A Gaussian a pixel on the left half of the image: sure above, uncertain below."""
    depths = torch.full((1, 1, 24, 24), 2.0)
    scales = pixel_scales(depths, CAMERA.intrinsics, 0.6)
    colours = torch.rand(1, 1, 3, 24, 24, generator=torch.Generator().manual_seed(0))
    opacities = torch.full_like(depths, 0.99)
    every = pixels_to_gaussians(colours, depths, CAMERA, scales, opacities)
    row, column = torch.meshgrid(torch.arange(24), torch.arange(24), indexing="ij")
    number = torch.where(row.flatten() < 12, 0.1, 0.8)[None]
    return replace(every, uncertainty=number).select((column < 12).flatten())


@pytest.mark.parametrize("rasterizer", ["numba", "torch"])
def test_a_map_shows_the_numbers_and_1_where_nothing_is(wall, rasterizer):
    shown = render_uncertainty(build("rasterizer", rasterizer), wall, CAMERA)[0, 0]
    assert shown.shape == (24, 24)
    assert shown.min() >= 0 and shown.max() <= 1
    torch.testing.assert_close(
        shown[2:9, 2:9], torch.full((7, 7), 0.1), atol=0.02, rtol=0
    )
    torch.testing.assert_close(
        shown[15:22, 2:9], torch.full((7, 7), 0.8), atol=0.02, rtol=0
    )
    assert (shown[:, 16:] == 1).all()


def test_a_scene_without_uncertainty_has_no_map(wall):
    with pytest.raises(ValueError, match="nobody estimated"):
        render_uncertainty(
            build("rasterizer", "torch"), replace(wall, uncertainty=None), CAMERA
        )
