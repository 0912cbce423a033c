"""What else than its pictures speaks against a scene."""

import re
from dataclasses import replace

import pytest
import torch
from edit3r_judge.critic import doubt_of

from edit3r.contract.interfaces import SceneToJudge
from edit3r.contract.types import Rendering, Views
from edit3r.contract.verdicts import EditVerdict
from edit3r_testing import gaussian_cloud
from edit3r_testing.scenes import cameras_around

BLACK = EditVerdict("doubtful", "it is black", {"faults": ["a black picture"]})


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"fov_range": (31.0, 75.2)}, "from 31 to 75 degrees.*--fov"),
        ({"flat": True}, "one plane.*--fov"),
        ({"edit": BLACK}, "2D edits do not show"),
    ],
)
def test_a_scene_is_at_most_fair_where_photos_do_not_tell_or_edits_are_none(
    changes, said
):
    views = Views(torch.zeros(1, 2, 3, 8, 8), cameras_around(2).intrinsics)
    shown = Rendering(views.images, *(torch.ones(1, 2, 1, 8, 8) for _ in range(2)))
    drawn = (views, cameras_around(2), gaussian_cloud(1), shown, shown)
    scene = SceneToJudge(views, (True, True), None, *drawn, None)
    assert doubt_of(scene) is None
    doubt = doubt_of(replace(scene, **changes))
    assert doubt.best == "fair" and re.search(said, doubt.clause)


def test_edits_that_were_moved_back_are_told_and_may_still_be_good():
    views = Views(torch.zeros(1, 2, 3, 8, 8), cameras_around(2).intrinsics)
    shown = Rendering(views.images, *(torch.ones(1, 2, 1, 8, 8) for _ in range(2)))
    drawn = (views, cameras_around(2), gaussian_cloud(1), shown, shown)
    moved = EditVerdict("good", "as asked", {"faults": [], "moved": ["a was shifted"]})
    scene = SceneToJudge(views, (True, True), None, *drawn, None, edit=moved)
    doubt = doubt_of(scene)
    assert doubt.best == "good" and "moved back" in doubt.clause
