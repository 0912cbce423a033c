"""Which points the other views show or contradict, in a scene whose geometry is known."""

import dataclasses

import pytest
import torch

from edit3r.geometry.cameras import unproject
from edit3r.geometry.visibility import in_front_of_others, seen_by, seen_by_others
from edit3r.interfaces import MatchedGeometry
from edit3r.testing import photograph

SCENE = photograph(2, (48, 64))
INTRINSICS = SCENE.views.intrinsics


@pytest.fixture
def truth():
    registered = torch.ones(1, 2, dtype=torch.bool)
    return MatchedGeometry(SCENE.cameras.c2w, SCENE.depths, torch.ones_like(SCENE.depths), registered)


def test_a_guess_before_what_another_view_measured_stands_in_front_of_it(truth):
    depths, confidence = truth.depths.clone(), truth.confidence.clone()
    depths[0, 0, 20:24, 30:34] *= 0.5
    confidence[0, 0, 20:24, 30:34] = 0
    found = in_front_of_others(dataclasses.replace(truth, depths=depths, confidence=confidence), INTRINSICS)
    assert found[0, 0, 20:24, 30:34].all() and found.sum() == 16
    assert not in_front_of_others(dataclasses.replace(truth, depths=depths), INTRINSICS).any()


def test_views_see_their_own_points_and_most_of_the_others(truth):
    points = unproject(truth.depths, INTRINSICS, truth.c2w).flatten(2, 3)
    assert seen_by(points[:, 1], truth, INTRINSICS, 1).all()
    assert 0.5 < seen_by_others(truth, INTRINSICS).float().mean() < 1


def test_a_view_that_is_not_registered_sees_nothing(truth):
    alone = dataclasses.replace(truth, registered=torch.tensor([[True, False]]))
    assert not seen_by_others(alone, INTRINSICS)[:, 0].any()
    assert seen_by_others(alone, INTRINSICS)[:, 1].any()
