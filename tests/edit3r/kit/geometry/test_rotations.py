import math

import torch
from hypothesis import given, strategies as st

from edit3r.kit.geometry import rotations

UNIT = st.floats(-1, 1, allow_nan=False)


@given(st.tuples(UNIT, UNIT, UNIT, UNIT), st.floats(1e-6, 1e6))
def test_matrices_are_rotations_for_quaternions_of_any_norm(quat, norm):
    quats = torch.tensor(quat, dtype=torch.float64)
    quats = rotations.normalise_quats(quats) * norm
    matrix = rotations.quats_to_matrices(quats)
    assert torch.allclose(
        matrix @ matrix.T, torch.eye(3, dtype=torch.float64), atol=1e-9
    )
    assert math.isclose(float(torch.linalg.det(matrix)), 1, abs_tol=1e-9)


@given(st.tuples(UNIT, UNIT, UNIT, UNIT))
def test_quaternions_survive_the_way_through_matrices_up_to_sign(quat):
    quats = rotations.normalise_quats(torch.tensor(quat, dtype=torch.float64))
    back = rotations.matrices_to_quats(rotations.quats_to_matrices(quats))
    assert min(float((back - quats).norm()), float((back + quats).norm())) < 1e-7
    assert back[0] >= 0


def test_half_turns_are_converted_without_loss():
    for axis in range(3):
        matrix = -torch.eye(3, dtype=torch.float64)
        matrix[axis, axis] = 1
        quats = rotations.matrices_to_quats(matrix)
        assert torch.allclose(rotations.quats_to_matrices(quats), matrix, atol=1e-12)


def test_the_zero_quaternion_is_the_identity_with_zero_gradient():
    quats = torch.zeros(4, requires_grad=True)
    matrix = rotations.quats_to_matrices(quats)
    assert torch.equal(matrix, torch.eye(3))
    matrix.sum().backward()
    assert torch.equal(quats.grad, torch.zeros(4))


def test_gradients_agree_with_finite_differences():
    quats = torch.randn(
        5,
        4,
        dtype=torch.float64,
        generator=torch.Generator().manual_seed(0),
        requires_grad=True,
    )
    scales = torch.rand(
        5,
        3,
        dtype=torch.float64,
        generator=torch.Generator().manual_seed(1),
        requires_grad=True,
    )
    assert torch.autograd.gradcheck(rotations.covariances, (scales, quats))


def test_a_quarter_turn_about_z_takes_x_to_y():
    quats = torch.tensor([math.cos(math.pi / 4), 0, 0, math.sin(math.pi / 4)])
    turned = rotations.quats_to_matrices(quats) @ torch.tensor([1.0, 0, 0])
    assert torch.allclose(turned, torch.tensor([0.0, 1, 0]), atol=1e-6)


def test_rotation_angle_is_accurate_for_tiny_and_half_turns():
    for angle in (1e-6, 0.01, 1.0, math.pi):
        quats = torch.tensor(
            [math.cos(angle / 2), 0, math.sin(angle / 2), 0], dtype=torch.float64
        )
        matrix = rotations.quats_to_matrices(quats)
        measured = float(
            rotations.rotation_angle(matrix, torch.eye(3, dtype=torch.float64))
        )
        assert math.isclose(measured, angle, rel_tol=1e-6)
