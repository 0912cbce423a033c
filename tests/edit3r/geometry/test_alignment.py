import pytest
import torch

from edit3r.geometry.alignment import (
    median_scale,
    nearest_rotation,
    robust_similarity,
    weighted_similarity,
)
from edit3r.geometry.cameras import scale_poses
from edit3r.geometry.rotations import cross_matrix, rotation_angle


def _points(count=40, seed=0):
    random = torch.Generator().manual_seed(seed)
    points = torch.randn(2, count, 3, generator=random, dtype=torch.float64)
    turn = torch.linalg.matrix_exp(cross_matrix(torch.randn(2, 3, generator=random, dtype=torch.float64)))
    moved = 1.7 * points @ turn.transpose(1, 2) + torch.tensor([0.3, -0.2, 4.0], dtype=torch.float64)
    weights = torch.rand(2, count, generator=random, dtype=torch.float64) + 0.1
    return points, moved, weights, turn


def test_an_exact_similarity_is_recovered():
    points, moved, weights, turn = _points()
    fit = weighted_similarity(points, moved, weights)
    assert torch.allclose(fit.rotation, turn, atol=1e-9)
    assert torch.allclose(fit.scale, torch.full((2,), 1.7, dtype=torch.float64))
    assert torch.allclose(fit.apply(points), moved, atol=1e-9)


@pytest.mark.parametrize("part", ["scale", "rotation", "translation"])
def test_gradients_agree_with_finite_differences(part):
    points, moved, weights, _ = _points(count=7)
    moved = moved + 0.2 * torch.randn(moved.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    inputs = [x.requires_grad_() for x in (points, moved, weights)]
    assert torch.autograd.gradcheck(lambda *x: getattr(weighted_similarity(*x), part), inputs, eps=1e-6, atol=1e-6)


def test_gradients_hold_where_singular_values_coincide():
    corners = torch.cat((torch.eye(3), -torch.eye(3))).double()[None].requires_grad_()
    weights = torch.ones(1, 6, dtype=torch.float64)
    target = corners.detach().clone()
    assert torch.autograd.gradcheck(lambda x: weighted_similarity(x, target, weights).rotation, [corners])


def test_a_mirrored_cloud_still_gives_a_proper_rotation():
    points, _, weights, _ = _points()
    mirrored = points * torch.tensor([-1.0, 1, 1], dtype=torch.float64)
    assert torch.allclose(
        torch.linalg.det(weighted_similarity(points, mirrored, weights).rotation), torch.ones(2).double()
    )


@pytest.mark.parametrize("kind", ["no weight", "one point", "a line", "huge"])
def test_degenerate_input_stays_finite_with_its_gradient(kind):
    points, moved, weights, _ = _points()
    if kind == "no weight":
        weights = torch.zeros_like(weights)
    if kind == "one point":
        points, moved = torch.zeros_like(points), torch.ones_like(moved)
    if kind == "a line":
        points = points[..., :1] * torch.ones(3, dtype=torch.float64)
    if kind == "huge":
        points = points * 1e6
    points.requires_grad_()
    fit = weighted_similarity(points, moved, weights)
    (fit.rotation.sum() + fit.translation.sum() + fit.scale.sum()).backward()
    assert all(torch.isfinite(x).all() for x in (fit.rotation, fit.translation, fit.scale, points.grad))


def test_a_third_of_outliers_hardly_turns_the_robust_fit():
    points, moved, weights, turn = _points(count=90)
    spoiled = moved.clone()
    spoiled[:, ::3] = torch.randn(2, 30, 3, generator=torch.Generator().manual_seed(2), dtype=torch.float64) * 3
    plain = rotation_angle(weighted_similarity(points, spoiled, weights).rotation, turn)
    robust = rotation_angle(robust_similarity(points, spoiled, weights).rotation, turn)
    assert (robust < 0.02).all() and (robust < 0.2 * plain).all()


def test_the_nearest_rotation_of_a_rotation_is_itself():
    turn = torch.linalg.matrix_exp(cross_matrix(torch.tensor([[0.3, -1.0, 0.4]])))
    assert torch.allclose(nearest_rotation(3 * turn), turn, atol=1e-6)


def test_poses_in_another_unit_keep_their_rotations_and_give_the_factor_back():
    poses = torch.eye(4).repeat(2, 3, 1, 1)
    poses[:, 1:, :3, 3] = torch.rand(2, 2, 3, generator=torch.Generator().manual_seed(0)) + 0.1
    scaled = scale_poses(poses, torch.tensor([[2.0], [0.5]]))
    assert torch.equal(scaled[..., :3, :3], poses[..., :3, :3])
    assert torch.equal(scaled[0, :, :3, 3], 2 * poses[0, :, :3, 3])
    assert torch.equal(scale_poses(poses[0], 2.0), scaled[0])
    assert torch.isclose(median_scale(poses[1, 1:, :3, 3], scaled[1, 1:, :3, 3]), torch.tensor(0.5))
    assert median_scale(poses[0, :0, :3, 3], scaled[0, :0, :3, 3]) == 1
