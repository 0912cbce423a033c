"""Agreement of views, where it can be known: a wall that two cameras look at straight."""

import pytest
import torch
from edit3r_measure.evaluation.consistency import warped_difference, warped_picture

from edit3r.types import Cameras

SIZE, DEPTH, SHIFT = 32, 2.0, 0.5


@pytest.fixture
def cameras():
    """The second stands `SHIFT` to the right: with fx = 1 the wall moves SHIFT / DEPTH = a quarter picture left."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = SHIFT
    k = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])
    return Cameras(c2w, k.expand(1, 2, 3, 3), (SIZE, SIZE))


@pytest.fixture
def wall():
    """What both see, 8 pixels apart."""
    texture = torch.rand(3, SIZE, SIZE + 8, generator=torch.Generator().manual_seed(0))
    return torch.stack((texture[:, :, :SIZE], texture[:, :, 8:]))


@pytest.fixture
def depths():
    return torch.full((2, SIZE, SIZE), DEPTH)


def test_a_picture_is_carried_to_where_the_other_camera_sees_it(wall, depths, cameras):
    carried, seen = warped_picture(wall[1], depths[0], depths[1], cameras)
    assert not seen[:, :8].any() and seen[:, 8:].all()
    assert torch.allclose(carried[:, :, 8:], wall[0][:, :, 8:], atol=1e-5)


def test_one_wall_agrees_and_a_tinted_one_differs_by_the_tint(wall, depths, cameras):
    pairs = [(0, 1), (1, 0)]
    assert warped_difference(wall, depths, cameras, pairs) == pytest.approx(0, abs=1e-5)
    tinted = torch.stack((wall[0], wall[1] + 0.125))
    assert warped_difference(tinted, depths, cameras, pairs) == pytest.approx(0.125, abs=1e-5)


def test_only_the_mask_counts(wall, depths, cameras):
    tinted = torch.stack((wall[0], wall[1].clone()))
    tinted[1, :, :16] += 0.5
    lower = torch.zeros(2, SIZE, SIZE)
    lower[:, 18:] = 1
    assert warped_difference(tinted, depths, cameras, [(0, 1)], lower) == pytest.approx(0, abs=1e-5)
    assert warped_difference(tinted, depths, cameras, [(0, 1)], 1 - lower) > 0.3


def test_hidden_points_do_not_count(wall, depths, cameras):
    hiding = depths.clone()
    hiding[1] = 1.0  # the second camera sees something nearer everywhere
    assert warped_difference(wall, hiding, cameras, [(0, 1)]) != warped_difference(wall, hiding, cameras, [(0, 1)])
