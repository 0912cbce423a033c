import math

import pytest
import torch

from edit3r.kit.geometry.cameras import quarter_turns, up_direction, upright


def camera(pan, tilt, roll=0.0):
    """Pose of a camera on an upright stand (y points down), turned by degrees."""

    def turned(axis, degrees):
        a, b = [other for other in range(3) if other != axis]
        pose = torch.eye(4, dtype=torch.float64)
        angle = math.radians(degrees)
        pose[a, a] = pose[b, b] = math.cos(angle)
        pose[a, b] = -math.sin(angle)
        pose[b, a] = math.sin(angle)
        return pose

    return turned(1, pan) @ turned(0, tilt) @ turned(2, roll)


def off(c2w):
    """Degrees between the up that is found and the true one."""
    up = up_direction(torch.stack(c2w))
    return math.degrees(torch.acos(-up[1].clamp(-1, 1)))


@pytest.mark.parametrize("tilt", [-40, 0, 40])
def test_cameras_around_a_thing_find_up_although_all_are_tilted(tilt):
    assert off([camera(pan, tilt) for pan in (0, 40, 80)]) < 3


def test_cameras_that_face_one_way_give_their_own_up():
    assert off([camera(0, 10), camera(0, 10)]) == pytest.approx(10, abs=1e-3)


@pytest.mark.parametrize("roll", [90, 180, 270])
def test_one_image_on_its_side_does_not_tilt_the_scene_and_is_found(roll):
    held = [camera(pan, 20) for pan in (0, 30, 60, 90)]
    upright = off(held)
    held[2] = camera(60, 20, roll)
    assert off(held) == pytest.approx(upright, abs=1e-6)
    c2w = torch.stack(held)
    turns = quarter_turns(c2w)
    assert turns.tolist()[:2] == [0, 0]
    # Turned anticlockwise so often, the image is upright: its y axis points down as before.
    x, y = c2w[2, :3, 0], c2w[2, :3, 1]
    down = (y, -x, -y, x)[turns[2]]
    torch.testing.assert_close(down, camera(60, 20)[:3, 1])


def test_images_held_every_way_round_go_by_the_first():
    assert off([camera(0, 0), camera(0, 0, 180)]) < 1e-3


@pytest.mark.parametrize("tilt", [-90, -40, 0, 40, 90])
def test_upright_is_a_rotation_that_keeps_the_camera_s_heading(tilt):
    """Of a camera that looks straight down or up, the top of its image says where ahead is."""
    c2w = camera(30, tilt)[:3, :3]
    rotation = upright(c2w.new_tensor([0, -1, 0]), c2w)
    assert torch.det(rotation) == pytest.approx(1)
    torch.testing.assert_close(rotation[1], c2w.new_tensor([0, 1, 0]))
    ahead = rotation @ camera(30, 0)[:3, 2]
    torch.testing.assert_close(ahead, c2w.new_tensor([0, 0, 1]))
