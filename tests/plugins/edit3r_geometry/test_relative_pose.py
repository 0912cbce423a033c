import math
from functools import partial

import cv2
import numpy as np
import pytest
from edit3r_geometry.cameras import Pose, cross_matrix, parallax_degrees, triangulate
from edit3r_geometry.relative_pose import (
    Matches,
    _moved,
    _settled,
    agreeing,
    estimate_pose,
    log_chance,
    log_false_alarms,
    refine,
    sampson_errors,
    sharp_support,
    support,
)
from scipy.optimize import least_squares

from edit3r.kit.photos.triples import rotation_degrees

FOCAL = 250.0
CHANCE = 0.011


@pytest.fixture
def pose():
    translation = np.array([0.9, 0.1, -0.2])
    turn = cv2.Rodrigues(np.array([0.03, -0.15, 0.02]))[0]
    return Pose(turn, translation / np.linalg.norm(translation))


def points(count, seed=0):
    random = np.random.default_rng(seed)
    sides = (-2, 2), (-2, 2), (3, 8)
    return np.stack([random.uniform(*side, count) for side in sides], axis=1)


def seen(points):
    return points / points[:, 2:]


def test_triangulation_of_exact_rays_is_exact(pose):
    world = points(50)
    moved = pose.apply(world)
    depth_a, depth_b = triangulate(seen(world), seen(moved), pose)
    assert np.allclose(depth_a, world[:, 2]) and np.allclose(depth_b, moved[:, 2])


def test_parallax_is_the_angle_at_the_point():
    pose = Pose(np.eye(3), np.array([-1.0, 0, 0]))
    rays = np.array([[0.0, 0, 1]])
    moved = seen(pose.apply(rays))
    assert parallax_degrees(rays, moved, pose) == pytest.approx(45)


def test_sampson_error_is_the_distance_moved_off_the_epipolar_line(pose):
    world = points(200)
    a, b = seen(world), seen(pose.apply(world))
    lines = a @ (cross_matrix(pose.translation) @ pose.rotation).T
    normals = lines[:, :2] / np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    b[:, :2] += 1e-4 * normals
    errors = np.abs(sampson_errors(Matches(a, b, FOCAL, CHANCE), pose))
    # The error is shared between the two pictures: at most the shift, at least a good part of it.
    assert (errors <= 1e-4 * FOCAL * 1.001).all() and (errors > 0.3e-4 * FOCAL).all()


def test_sampson_error_counts_both_images_alike(pose):
    """The other way round, with the inverse pose, it is the same."""
    world = points(200)
    random = np.random.default_rng(1)
    a, b = seen(world), seen(pose.apply(world))
    b[:, :2] += 1e-3 * random.standard_normal((200, 2))
    b = b * [3, 3, 1]  # a longer lens: its epipolar lines are steeper than those of A
    errors = sampson_errors(Matches(a, b, FOCAL, CHANCE), pose)
    back = sampson_errors(Matches(b, a, FOCAL, CHANCE), pose.inverse())
    assert np.abs(errors).max() > 0
    assert np.allclose(np.abs(errors), np.abs(back), rtol=1e-6, atol=1e-9)


def test_points_behind_either_camera_do_not_count():
    """B looks back at A from three units ahead; farther points are behind it."""
    pose = Pose(np.diag([-1.0, 1, -1]), np.array([0.5, 0.2, 3]) / np.hypot(3, 0.5385))
    length = np.hypot(3, 0.5385)
    world = points(60) / length
    world[:30, 2] = np.linspace(1, 2, 30) / length
    moved = pose.apply(world)
    between = (world[:, 2] > 0) & (moved[:, 2] > 0)
    matches = Matches(seen(world), seen(moved), FOCAL, CHANCE)
    _, inliers = support(matches, pose, threshold=1.0)
    assert 0 < between.sum() < 60 and (inliers == between).all()
    assert sharp_support(matches, pose, threshold=1.0) == pytest.approx(between.sum())


def test_pose_survives_noise_and_wrong_matches(pose):
    random = np.random.default_rng(1)
    world = points(300)
    a, b = seen(world), seen(pose.apply(world))
    b[:, :2] += random.normal(0, 0.3 / FOCAL, (300, 2))
    b[:120] = seen(points(120, seed=9))
    found = estimate_pose(Matches(a, b, FOCAL, CHANCE), threshold=1.0, seed=0)
    assert rotation_degrees(found.pose.rotation, pose.rotation) < 0.3
    assert found.pose.translation @ pose.translation > np.cos(np.radians(2))
    assert found.inliers[120:].mean() > 0.9
    assert found.log_false_alarms < -50


@pytest.mark.parametrize("seed", range(3))
def test_random_matches_do_not_count_as_a_pose(seed):
    random = np.random.default_rng(seed)
    a, b = (
        np.concatenate([random.uniform(-0.5, 0.5, (150, 2)), np.ones((150, 1))], axis=1)
        for _ in range(2)
    )
    found = estimate_pose(Matches(a, b, FOCAL, CHANCE), threshold=1.0, seed=0)
    assert found is None or found.log_false_alarms > -6


def test_alarms_and_chance_are_counted_in_tens():
    """0.2^4 * 10 * 7 * C(12, 9) * C(9, 5) five-point models; C(12, 9) * 0.2^9 matches."""
    models = 10 * 7 * math.comb(12, 9) * math.comb(9, 5) * 0.2**4
    assert log_false_alarms(12, 9, 0.2) == pytest.approx(math.log10(models))
    assert log_false_alarms(12, 5, 0.2) == math.inf > log_false_alarms(12, 6, 0.2)
    chance = math.log10(math.comb(12, 9) * 0.2**9)
    assert log_chance(12, 9, 0.2) == pytest.approx(chance)


def test_matches_said_to_be_inexact_move_the_pose_less(pose):
    random = np.random.default_rng(3)
    world = points(400)
    a, b = seen(world), seen(pose.apply(world))
    noise = np.where(np.arange(400) < 100, 1.0, 4.0)
    b[:, :2] += random.normal(0, 0.15 / FOCAL, (400, 2)) * noise[:, None]
    errors = []
    for told in (noise, None):
        found = refine(Matches(a, b, FOCAL, CHANCE, told), pose, threshold=1.0)
        errors.append(rotation_degrees(found.rotation, pose.rotation))
    assert errors[0] < 0.6 * errors[1]


def test_a_refined_pose_is_where_the_robust_loss_is_least(pose):
    """As scipy finds it, from a start that is off by five degrees."""
    random = np.random.default_rng(4)
    a, b = seen(points(200)), seen(pose.apply(points(200)))
    b[:, :2] += random.normal(0, 0.3 / FOCAL, (200, 2))
    matches = Matches(a, b, FOCAL, CHANCE)
    turn = cv2.Rodrigues(np.array([0.06, -0.08, 0.02]))[0]
    start = Pose(turn @ pose.rotation, pose.translation)
    moved = partial(_moved, start)
    errors = lambda x: sampson_errors(matches, moved(x))  # noqa: E731
    best = least_squares(errors, np.zeros(5), loss="cauchy", f_scale=0.25)
    found = _settled(matches, start, 0.25)
    assert rotation_degrees(found.rotation, moved(best.x).rotation) < 1e-3
    assert np.abs(found.translation - moved(best.x).translation).max() < 1e-4


def test_too_few_matches_give_no_pose(pose):
    world = points(8)
    matches = Matches(seen(world), seen(pose.apply(world)), FOCAL, CHANCE)
    assert estimate_pose(matches, 1.0, 0) is None


def test_points_that_opencv_gives_up_on_agree_on_nothing(monkeypatch):
    def gives_up(*given):
        raise cv2.error("Assertion failed: !model.empty()")

    points = np.random.default_rng(0).random((30, 2))
    monkeypatch.setattr(cv2, "findFundamentalMat", gives_up)
    assert agreeing(points, points, 1.0) is None
