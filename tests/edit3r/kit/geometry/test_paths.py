import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from edit3r.contract.types import Cameras
from edit3r.kit.geometry.cameras import intrinsics_from_fov, project
from edit3r.kit.geometry.paths import (
    between_and_around,
    half_way,
    interpolate_poses,
)
from edit3r.kit.geometry.rotations import quats_to_matrices, rotation_angle


def pose(quat=(1.0, 0, 0, 0), centre=(0.0, 0, 0)):
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] = quats_to_matrices(torch.tensor(quat, dtype=torch.float64))
    matrix[:3, 3] = torch.tensor(centre, dtype=torch.float64)
    return matrix


def orbit(angles, radius=4.0):
    """Cameras around the point `radius` in front of the first, all looking at it."""
    poses = []
    for angle in angles:
        matrix = pose((math.cos(angle / 2), 0, math.sin(angle / 2), 0))
        matrix[:3, 3] = (
            torch.tensor([0, 0, radius])
            - matrix[:3, :3] @ torch.tensor([0, 0, radius]).double()
        )
        poses.append(matrix)
    return torch.stack(poses)


def cameras(poses):
    intrinsics = intrinsics_from_fov(1.0, (48, 64)).expand(1, len(poses), 3, 3)
    return Cameras(poses.float()[None], intrinsics, (48, 64))


def twist(rotation, velocity):
    """Element of the Lie algebra of SE(3) as a matrix."""
    x, y, z = rotation
    rows = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    rows = [[*row, v] for row, v in zip(rows, velocity)]
    return torch.tensor([*rows, [0, 0, 0, 0]], dtype=torch.float64)


@given(
    st.tuples(
        *[st.floats(-1.8, 1.8)] * 3
    ),  # at most 1.8 sqrt(3) < pi: one logarithm only
    st.tuples(*[st.floats(-5, 5)] * 3),
    st.floats(0, 1),
)
@settings(max_examples=60)
def test_interpolation_is_the_exponential_of_a_share_of_the_twist(
    rotation, velocity, share
):
    start = pose((0.3, 0.1, -0.5, 0.8), (1.0, 2.0, 3.0))
    whole = twist(rotation, velocity)
    part = interpolate_poses(
        start, start @ torch.matrix_exp(whole), torch.tensor(share, dtype=torch.float64)
    )
    torch.testing.assert_close(
        part, start @ torch.matrix_exp(share * whole), atol=1e-8, rtol=0
    )


def test_interpolation_without_rotation_is_a_straight_line():
    end = pose(centre=(2.0, 0, 0))
    middle = interpolate_poses(pose(), end, torch.tensor(0.25).double())
    torch.testing.assert_close(middle, pose(centre=(0.5, 0, 0)))


def test_interpolation_is_accurate_for_tiny_rotations():
    quat = (math.cos(0.5e-5), 0, math.sin(0.5e-5), 0)
    middle = interpolate_poses(
        pose(), pose(quat, (1.0, 0, 0)), torch.tensor(0.5).double()
    )
    torch.testing.assert_close(
        middle[:3, 3], torch.tensor([0.5, 0, 1e-5 / 8]).double(), atol=1e-10, rtol=0
    )


def test_between_two_orbiting_views_the_camera_stays_on_their_circle():
    poses = orbit([0.0, 2.0])
    middle = interpolate_poses(poses[0], poses[1], torch.tensor(0.5).double())
    torch.testing.assert_close(middle, orbit([1.0])[0])


def test_path_passes_every_view_exactly_and_starts_at_the_first():
    poses = orbit([0.0, 0.2, 0.5])
    path = between_and_around(cameras(poses), 30, depth=4.0)
    torch.testing.assert_close(path.c2w[0, ::10], poses.float(), atol=1e-6, rtol=0)
    assert path.count == 30 and path.image_size == (48, 64)


def test_path_goes_up_and_down_around_the_line_between_two_views():
    path = between_and_around(
        cameras(torch.stack((pose(), pose(centre=(1.0, 0, 0))))), 40, depth=5.0
    )
    heights = path.c2w[0, :, 1, 3]
    assert heights[10] < -0.1 and heights[30] > 0.1
    torch.testing.assert_close(heights[10], -heights[30])


@pytest.mark.slow
@given(st.integers(1, 6), st.integers(0, 2**31 - 1), st.sampled_from([None, 0.5, 4.0]))
@settings(max_examples=40)
def test_path_is_never_wild(views, seed, depth):
    generator = torch.Generator().manual_seed(seed)
    angles = (torch.rand(views, generator=generator) - 0.5).tolist()
    given_cameras = cameras(orbit([0.0, *angles[1:]]))
    path = between_and_around(given_cameras, 24, depth)
    centres, inputs = path.c2w[0, :, :3, 3], given_cameras.c2w[0, :, :3, 3]
    extent = torch.cdist(inputs, inputs).max()
    allowed = extent + (0.08 * depth if depth else 0.25 * extent) + 1e-4
    assert torch.isfinite(path.c2w).all()
    assert torch.cdist(centres, inputs).min(1).values.max() <= allowed
    rotations = path.c2w[0, :, :3, :3]
    torch.testing.assert_close(
        rotations @ rotations.mT, torch.eye(3).expand(24, 3, 3), atol=1e-5, rtol=0
    )


def test_path_is_a_smooth_loop():
    path = between_and_around(cameras(orbit([0.0, 0.3, -0.3, 0.6])), 240, depth=4.0)
    closed = torch.cat((path.c2w[0], path.c2w[0, :2]))
    steps = closed[1:, :3, 3] - closed[:-1, :3, 3]
    jerks = (steps[1:] - steps[:-1]).norm(dim=-1)
    assert jerks.max() < 0.25 * steps.norm(dim=-1).max()
    turns = rotation_angle(closed[1:, :3, :3], closed[:-1, :3, :3])
    assert turns.max() < 0.05


def test_camera_keeps_the_scene_in_the_middle_while_it_swings():
    path = between_and_around(cameras(orbit([0.0, 0.4])), 16, depth=4.0)
    target = torch.tensor([[0.0, 0, 4.0]]).expand(1, 16, 1, 3)
    where, z = project(target, path.intrinsics, path.c2w)
    torch.testing.assert_close(where, torch.full_like(where, 0.5), atol=1e-4, rtol=0)
    assert (z > 3.5).all()


def test_one_view_is_circled_when_the_depth_is_known_and_kept_when_it_is_not():
    lone = cameras(orbit([0.0]))
    circled = between_and_around(lone, 8, depth=4.0)
    torch.testing.assert_close(circled.c2w[0, 0], torch.eye(4))
    assert circled.c2w[0, :, :3, 3].norm(dim=-1).max() > 0.1
    torch.testing.assert_close(
        between_and_around(lone, 8).c2w[0], torch.eye(4).expand(8, 4, 4)
    )


def test_intrinsics_pass_from_view_to_view():
    pair = cameras(orbit([0.0, 0.2]))
    pair.intrinsics.data = pair.intrinsics.clone()
    pair.intrinsics[0, 1, 0, 0] = 2.0
    path = between_and_around(pair, 8)
    assert path.intrinsics[0, 4, 0, 0] == 2.0
    assert path.intrinsics[0, 0, 0, 0] < path.intrinsics[0, 2, 0, 0] < 2.0


def test_no_frames_is_an_error():
    with pytest.raises(ValueError, match="at least 1 frame"):
        between_and_around(cameras(orbit([0.0, 0.2])), 0)


def test_half_way_cameras_stand_between_each_view_and_its_nearest_once():
    c2w = torch.eye(4).repeat(1, 3, 1, 1)
    c2w[0, :, 0, 3] = torch.tensor([0.0, 1.0, 5.0])
    lenses = torch.eye(3) * torch.tensor([1.0, 2.0, 3.0])[:, None, None]
    cameras, pairs = half_way(Cameras(c2w, lenses[None], (4, 6)))
    assert pairs == ((0, 1), (1, 2))
    assert cameras.c2w[0, :, 0, 3].tolist() == pytest.approx([0.5, 3.0])
    assert torch.equal(cameras.intrinsics[0], lenses[:2])
    assert cameras.image_size == (4, 6)


def test_views_far_apart_before_a_near_scene_are_not_swung_out_of_it():
    poses = torch.stack((pose(), pose(centre=(10.0, 0, 0))))
    path = between_and_around(cameras(poses), 40, depth=5.0)
    assert 0.35 < path.c2w[0, :, 1, 3].abs().max() < 0.41
