import numpy as np
import pytest
from edit3r_geometry.cameras import CalibratedImage, Pose, pixel_rays
from edit3r_geometry.ground import Ground, above_ground, find_ground
from edit3r_geometry.plane_sweep import RawDepth

SIZE = (48, 64)
INTRINSICS = np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])
IMAGE = CalibratedImage(np.zeros((*SIZE, 3), np.float32), INTRINSICS)
WALL = 10.0  # distance of the wall [units]
FOOT = 1.5  # the wall begins so far below the cameras [units]


def turned(degrees):
    """World to camera of a camera at the origin that looks down by some degrees."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return Pose(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.zeros(3))


def wall(pose):
    """Inverse depth of a wall across the world's z axis, and what of it stands above its foot."""
    directions = pose.inverse().apply(pixel_rays(INTRINSICS, SIZE))
    points = directions * (WALL / directions[..., 2:])
    depth = pose.apply(points)[..., 2]
    return (1 / depth).astype(np.float32), points[..., 1] < FOOT


def found(poses, keep=lambda measured: measured):
    seen = [wall(pose) for pose in poses]
    raw = {i: RawDepth(inverse, 0.01, 0.01) for i, (inverse, _) in enumerate(seen)}
    measured = {i: keep(shown.copy()) for i, (_, shown) in enumerate(seen)}
    return find_ground([IMAGE] * len(poses), poses, raw, measured)


POSES = [turned(-1), turned(1)]


def test_the_ground_begins_at_the_foot_of_a_wall():
    ground = found(POSES)
    np.testing.assert_allclose(ground.up, (0, -1, 0), atol=1e-4)
    assert ground.height == pytest.approx(-FOOT, abs=0.2)


def test_guesses_are_lifted_onto_the_ground_and_measured_depth_stays():
    """A lawn before the wall, whose depth was guessed to be the wall's."""
    pose = POSES[1]
    guess, measured = wall(pose)
    lifted = above_ground(
        guess, measured, IMAGE, pose, Ground(np.array([0, -1.0, 0]), -FOOT)
    )
    assert (lifted[measured] == guess[measured]).all()
    points = pose.inverse().apply(pixel_rays(INTRINSICS, SIZE) / lifted[..., None])
    np.testing.assert_allclose(points[~measured][:, 1], FOOT, rtol=1e-5)
    assert points[-1, :, 2].max() < 0.7 * WALL


def test_what_was_measured_below_the_ground_stays():
    pit = np.full(SIZE, 0.01, np.float32)
    ground = Ground(np.array([0, -1.0, 0]), -FOOT)
    kept = above_ground(pit, np.ones(SIZE, bool), IMAGE, Pose.identity(), ground)
    assert (kept == pit).all()


def test_a_photo_on_its_side_has_no_say():
    on_its_side = Pose(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]), np.zeros(3))

    def free_below(measured):
        measured[38:] = False
        return measured

    upright = found(POSES, free_below)
    three = found([*POSES, on_its_side], free_below)
    assert three.height == pytest.approx(upright.height, abs=1e-3)


def test_a_guess_above_the_ground_stays():
    guess = np.full(SIZE, 1.0, np.float32)
    ground = Ground(np.array([0, -1.0, 0]), -FOOT)
    lifted = above_ground(guess, np.zeros(SIZE, bool), IMAGE, Pose.identity(), ground)
    assert (lifted == guess).all()


def only_left_half(measured):
    measured[:, 32:] = False
    return measured


def down_to_the_edge(measured):
    measured[:] = True
    return measured


def on_a_slope(measured):
    measured[:] = True
    for column in range(64):
        measured[26 + 18 * column // 64 :, column] = False
    return measured


@pytest.mark.parametrize("keep", [only_left_half, down_to_the_edge, on_a_slope])
def test_no_ground_where_the_photos_do_not_agree_on_one(keep):
    assert found(POSES, keep) is None


def test_no_ground_above_the_cameras():
    """A cliff across a valley, seen down to a height above the cameras."""
    above = wall(turned(0))[1]
    above[8:] = False
    assert found(POSES, lambda measured: measured & above) is None
