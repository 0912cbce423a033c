import pytest
import torch
from edit3r_training.losses.center import CenterLoss
from edit3r_training.losses.geometry import GeometryLoss, chamfer_l1, pairwise_chamfer
from edit3r_training.losses.mse import MseLoss

from edit3r.errors import SettingsError
from edit3r.interfaces import LossInputs
from edit3r.testing import LossContract
from edit3r.types import Gaussians


class TestMse(LossContract):
    component = "mse"


class TestCenter(LossContract):
    component = "center"


class TestGeometry(LossContract):
    component = "geometry"


class TestPerceptual(LossContract):
    component = "perceptual"


def _gaussians(means: torch.Tensor, views: list[int]) -> Gaussians:
    count = means.shape[1]
    ones = torch.ones(1, count, 4)
    return Gaussians(means, ones[..., :3], ones, ones[..., 0], torch.zeros(1, count, 1, 3), torch.tensor(views))


def test_mse_is_blind_to_detail_within_a_cell_and_sees_a_shift_of_colour():
    target = torch.full((1, 1, 3, 8, 8), 0.5)
    detail = target.clone()
    detail[..., ::2] += 0.2
    detail[..., 1::2] -= 0.2
    loss = MseLoss(MseLoss.Settings(cell=4))
    assert float(loss(LossInputs(detail, target))) < 1e-12
    assert float(loss(LossInputs(target + 0.1, target))) == pytest.approx(0.01)


def test_center_is_linear_far_from_the_reference():
    reference = _gaussians(torch.zeros(1, 4, 3), [0, 0, 1, 1])
    far = _gaussians(torch.full((1, 4, 3), 10.0), [0, 0, 1, 1])
    loss = CenterLoss(CenterLoss.Settings())
    assert float(loss(LossInputs(gaussians=far, reference=reference))) == pytest.approx(9.5)


def test_chamfer_of_two_points_is_twice_their_l1_distance():
    a, b = torch.zeros(1, 1, 3), torch.tensor([[[1.0, 2.0, 3.0]]])
    assert float(chamfer_l1(a, b)) == pytest.approx(12)


def test_geometry_divides_by_views_times_views_less_one():
    """Three views at 0, 1 and 3 on a line: pairs 1, 2 and 3 apart, Chamfer 2, 4 and 6, sum 12, divided by 6."""
    means = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [3, 0, 0]]])
    assert float(pairwise_chamfer(means, [torch.tensor([i]) for i in range(3)])) == pytest.approx(2)


def test_geometry_has_the_same_gradient_with_and_without_a_reference():
    loss = GeometryLoss(GeometryLoss.Settings(samples=8))
    gradients = []
    for reference in (None, _gaussians(torch.zeros(1, 4, 3), [0, 0, 1, 1])):
        means = torch.tensor([[[0.0, 0, 0], [1, 1.5, 0], [0, 3, 0], [4, 0, 1]]], requires_grad=True)
        loss(LossInputs(gaussians=_gaussians(means, [0, 0, 1, 1]), reference=reference)).backward()
        gradients.append(means.grad)
    assert torch.equal(*gradients)


def test_a_step_without_a_reference_is_an_error_that_says_so():
    loss = CenterLoss(CenterLoss.Settings())
    with pytest.raises(SettingsError, match="no reference"):
        loss(LossInputs(gaussians=_gaussians(torch.zeros(1, 1, 3), [0])))
