"""Gaussians at pixels: their size, place, colour and order."""

import torch

from edit3r.geometry.cameras import unproject
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.unproject import pixel_scales, pixels_to_gaussians
from edit3r.testing import photograph


def test_size_of_a_gaussian_is_its_pixel_at_its_depth():
    scene = photograph(2, (12, 16))
    scales = pixel_scales(scene.depths, scene.views.intrinsics, footprint=0.5)
    focal = scene.views.intrinsics[0, 0, 0, 0] * scene.views.image_size[1]
    assert torch.allclose(scales, 0.5 * scene.depths / focal, rtol=1e-6)


def test_gaussians_follow_the_pixels_view_by_view_and_row_by_row():
    scene = photograph(2, (12, 16), batch=2)
    images = scene.views.images
    gaussians = pixels_to_gaussians(images, scene.depths, scene.cameras, 0.1 * scene.depths, scene.depths / 10)
    assert gaussians.view_index.tolist() == [0] * 192 + [1] * 192
    points = unproject(scene.depths, scene.views.intrinsics, scene.cameras.c2w)
    assert torch.equal(gaussians.means, points.flatten(1, 3))
    assert torch.equal(gaussians.scales[..., 2], 0.1 * scene.depths.flatten(1))
    assert torch.equal(gaussians.opacities, scene.depths.flatten(1) / 10)
    assert torch.allclose(dc_to_colour(gaussians.harmonics[:, :, 0]), images.movedim(2, -1).flatten(1, 3), atol=1e-6)
