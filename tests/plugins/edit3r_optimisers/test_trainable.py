"""Trainable parameters: made from Gaussians and back, and stepped by Adam."""

import pytest
import torch
from edit3r_optimisers.fitting import step_sizes
from edit3r_optimisers.settings import FitSettings
from edit3r_optimisers.trainable import TrainableGaussians

from edit3r.testing.scenes import gaussian_cloud

SIZES = step_sizes(FitSettings(), 0, 10, 1.0)


def test_gaussians_survive_the_way_in_and_out():
    scene = gaussian_cloud(5, degree=1)
    back = TrainableGaussians(scene, degree=1).gaussians()
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert torch.allclose(getattr(back, name), getattr(scene, name), atol=1e-6), name


def test_harmonics_are_cut_or_filled_up_to_the_degree():
    scene = gaussian_cloud(5, degree=1)
    assert torch.equal(TrainableGaussians(scene, degree=0).gaussians().harmonics, scene.harmonics[:, :, :1])
    more = TrainableGaussians(scene, degree=2).gaussians().harmonics
    assert torch.equal(more[:, :, :4], scene.harmonics) and not more[:, :, 4:].any()
    assert TrainableGaussians(scene, degree=2).gaussians(degree=1).degree == 1


def test_the_first_step_moves_each_kind_by_its_own_size():
    scene = TrainableGaussians(gaussian_cloud(6, degree=1), degree=1)
    before = {name: value.detach().clone() for name, value in scene.parameters.items()}
    scene.step(sum(value.sum() for value in scene.parameters.values()), SIZES)
    for name, value in scene.parameters.items():
        moved = before[name] - value.detach()
        assert torch.allclose(moved, torch.full_like(moved, SIZES[name]), rtol=1e-2, atol=1e-7), name


def test_a_restored_scene_takes_the_same_next_step():
    scene, twin = (TrainableGaussians(gaussian_cloud(count, degree=1), degree=1) for count in (6, 6))
    for _ in range(2):
        scene.step(scene.gaussians().means.square().sum() + scene.parameters["colour"].sum(), SIZES)
    twin.restore(scene.state())
    for one in (scene, twin):
        one.step(one.parameters["means"].square().sum() + one.parameters["colour"].square().sum(), SIZES)
    for name in ("means", "colour"):
        assert torch.equal(scene.parameters[name], twin.parameters[name])


def test_a_state_of_another_scene_is_refused():
    scene, other = (TrainableGaussians(gaussian_cloud(count, degree=1), degree=1) for count in (6, 5))
    with pytest.raises(RuntimeError):
        scene.restore(other.state())
