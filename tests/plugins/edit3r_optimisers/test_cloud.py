"""The optimiser's rows: made from Gaussians and back, and their moments when rows come and go."""

import pytest
import torch
from edit3r_optimisers.cloud import Cloud
from edit3r_optimisers.schedule import step_sizes
from edit3r_optimisers.settings import FitSettings

from edit3r.testing.scenes import gaussian_cloud

SIZES = step_sizes(FitSettings(), 0, 10, 1.0)


@pytest.fixture
def cloud() -> Cloud:
    """Six rows after two steps, so that every row has moments of its own."""
    cloud = Cloud(gaussian_cloud(6, degree=1), degree=1)
    for _ in range(2):
        loss = sum(
            (value * torch.linspace(1, 2, value.numel()).view_as(value)).sum() for value in vars(cloud.rows).values()
        )
        cloud.step(cloud.gradients(loss), SIZES)
    return cloud


def test_gaussians_survive_the_way_in_and_out():
    scene = gaussian_cloud(5, degree=1)
    back = Cloud(scene, degree=1).gaussians()
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        assert torch.allclose(getattr(back, name), getattr(scene, name), atol=1e-6), name


def test_harmonics_are_cut_or_filled_up_to_the_degree():
    scene = gaussian_cloud(5, degree=1)
    assert torch.equal(Cloud(scene, degree=0).gaussians().harmonics, scene.harmonics[:, :, :1])
    more = Cloud(scene, degree=2).gaussians().harmonics
    assert torch.equal(more[:, :, :4], scene.harmonics) and not more[:, :, 4:].any()
    assert Cloud(scene, degree=2).gaussians(degree=1).degree == 1


def test_rows_that_stay_keep_their_numbers_and_moments(cloud):
    kept = torch.tensor([True, False, True, True, False, False])
    before = {n: (v.detach().clone(), cloud.moments(n)) for n, v in vars(cloud.rows).items()}
    cloud.keep(kept)
    for name, (value, moments) in before.items():
        assert torch.equal(getattr(cloud.rows, name), value[kept]), name
        assert all(torch.equal(cloud.moments(name)[m], moments[m][kept]) for m in moments) and moments, name


def test_new_rows_begin_without_moments_and_leave_the_others_alone(cloud):
    before = cloud.moments("means")["exp_avg"]
    cloud.append(cloud.rows[torch.tensor([4, 0])], cloud.origin[[4, 0]])
    moment = cloud.moments("means")["exp_avg"]
    assert len(cloud) == 8 and torch.equal(moment[:6], before) and before.abs().min() > 0
    assert not moment[6:].any() and not cloud.moments("detail")["exp_avg_sq"][6:].any()
    assert torch.equal(cloud.rows.means[6:], cloud.rows.means[[4, 0]])


def test_capped_opacities_forget_their_moments_and_nothing_else_changes(cloud):
    means, colour = cloud.rows.means.detach().clone(), cloud.moments("colour")["exp_avg"]
    cloud.cap_opacities(0.01)
    assert cloud.gaussians().opacities.max() <= 0.01 + 1e-6
    assert not cloud.moments("opacities")["exp_avg"].any()
    assert torch.equal(cloud.rows.means, means) and torch.equal(cloud.moments("colour")["exp_avg"], colour)


def test_a_restored_cloud_takes_the_same_next_step(cloud):
    twin = Cloud(gaussian_cloud(3, degree=1), degree=1)
    twin.restore(cloud.state())
    for one in (cloud, twin):
        one.step(one.gradients(one.rows.means.square().sum()), SIZES)
    assert torch.equal(cloud.rows.means, twin.rows.means) and torch.equal(cloud.rows.colour, twin.rows.colour)
