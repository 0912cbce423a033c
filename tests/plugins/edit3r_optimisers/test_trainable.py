"""Trainable parameters: made from Gaussians and back, and stepped by Adam."""

import torch
from edit3r_optimisers.fitting import step_sizes
from edit3r_optimisers.settings import FitSettings
from edit3r_optimisers.trainable import TrainableGaussians

from edit3r.testing.scenes import gaussian_cloud

SIZES = step_sizes(FitSettings(), 0, 10, 1.0)


def test_gaussians_survive_the_way_in_and_out():
    scene = gaussian_cloud(5, degree=0)
    back = TrainableGaussians(scene).gaussians()
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert torch.allclose(getattr(back, name), getattr(scene, name), atol=1e-6), name


def test_the_first_step_moves_each_kind_by_its_own_size():
    scene = TrainableGaussians(gaussian_cloud(6, degree=0))
    before = {name: value.detach().clone() for name, value in scene.parameters.items()}
    scene.step(sum(value.sum() for value in scene.parameters.values()), SIZES)
    for name, value in scene.parameters.items():
        moved = before[name] - value.detach()
        assert torch.allclose(moved, torch.full_like(moved, SIZES[name]), rtol=1e-2, atol=1e-7), name
