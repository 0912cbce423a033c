"""Trainable parameters: made from Gaussians and back, and their moments when Gaussians come and go."""

import pytest
import torch
from edit3r_optimisers.fitting import step_sizes
from edit3r_optimisers.settings import FitSettings
from edit3r_optimisers.trainable import TrainableGaussians

from edit3r.testing.scenes import gaussian_cloud

SIZES = step_sizes(FitSettings(), 0, 10, 1.0)


@pytest.fixture
def scene() -> TrainableGaussians:
    """Six rows after two steps, so that every row has moments of its own."""
    scene = TrainableGaussians(gaussian_cloud(6, degree=1), degree=1)
    for _ in range(2):
        loss = sum(
            (value * torch.linspace(1, 2, value.numel()).view_as(value)).sum()
            for value in vars(scene.parameters).values()
        )
        scene.step(scene.gradients(loss), SIZES)
    return scene


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


def test_rows_that_stay_keep_their_numbers_and_moments(scene):
    kept = torch.tensor([True, False, True, True, False, False])
    before = [part.map(lambda value: value.detach().clone()) for part in (scene.parameters, scene.first, scene.second)]
    scene.keep(kept)
    for part, old in zip((scene.parameters, scene.first, scene.second), before):
        for name, value in vars(old).items():
            assert torch.equal(getattr(part, name), value[kept]) and value.any(), name


def test_new_rows_begin_without_moments_and_leave_the_others_alone(scene):
    before = scene.first.means
    scene.append(scene.parameters[torch.tensor([4, 0])], scene.view_index[[4, 0]])
    moment = scene.first.means
    assert len(scene) == 8 and torch.equal(moment[:6], before) and before.abs().min() > 0
    assert not moment[6:].any() and not scene.second.detail[6:].any()
    assert torch.equal(scene.parameters.means[6:], scene.parameters.means[[4, 0]])


def test_capped_opacities_forget_their_moments_and_nothing_else_changes(scene):
    means, colour = scene.parameters.means.detach().clone(), scene.first.colour
    scene.cap_opacities(0.01)
    assert scene.gaussians().opacities.max() <= 0.01 + 1e-6
    assert not scene.first.opacities.any()
    assert torch.equal(scene.parameters.means, means) and torch.equal(scene.first.colour, colour)


def test_a_restored_scene_takes_the_same_next_step(scene):
    twin = TrainableGaussians(gaussian_cloud(3, degree=1), degree=1)
    twin.restore(scene.state())
    for one in (scene, twin):
        one.step(one.gradients(one.parameters.means.square().sum()), SIZES)
    assert torch.equal(scene.parameters.means, twin.parameters.means)
    assert torch.equal(scene.parameters.colour, twin.parameters.colour)
