"""Depth pictures by closed forms."""

import torch
from edit3r_diffusers.controlnet_depth import control_images


def test_near_is_white_far_is_black_and_the_scale_is_shared_by_the_views():
    disparity = torch.linspace(0, 1, 64 * 64).view(1, 64, 64)
    pictures = control_images(torch.cat((disparity, disparity / 2)), (64, 64))
    assert pictures.shape == (2, 3, 64, 64)
    assert pictures.min() == 0 and pictures.max() == 1
    assert pictures[0, 0, -1, -1] == 1 and pictures[0, 0, 0, 0] == 0
    assert 0.4 < pictures[1].max() < 0.6


def test_a_flat_scene_gives_a_finite_picture():
    assert torch.isfinite(control_images(torch.ones(2, 8, 8), (16, 16))).all()
