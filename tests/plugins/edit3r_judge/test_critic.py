"""What else than its pictures speaks against a scene."""

import re
from dataclasses import replace

import pytest
import torch
from edit3r_judge.critic import confidence_of, doubt_of
from edit3r_judge.edit_verdict import EditMeasures, judge_edit

from edit3r.contract.interfaces import EditToJudge, SceneToJudge, Selected
from edit3r.contract.types import Rendering, Views
from edit3r_testing.scenes import cameras_around

BLACK = judge_edit(EditMeasures((1.0,), 1.0, faults=("a black picture",)))


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"lenses": (31.0, 75.2)}, "from 31 to 75 degrees.*--fov"),
        ({"flat": True}, "one plane.*--fov"),
        ({"edit": BLACK}, "2D edits do not show"),
    ],
)
def test_a_scene_is_at_most_fair_where_photos_do_not_tell_or_edits_are_none(
    changes, said
):
    views = Views(torch.zeros(1, 2, 3, 8, 8), cameras_around(2).intrinsics)
    shown = Rendering(views.images, *(torch.ones(1, 2, 1, 8, 8) for _ in range(2)))
    scene = SceneToJudge(views, (True, True), None, views, shown, shown, None)
    assert doubt_of(scene) is None
    doubt = doubt_of(replace(scene, **changes))
    assert doubt.best == "fair" and re.search(said, doubt.clause)


@pytest.mark.parametrize(
    "things, confidence",
    [
        ([], None),
        ([("marked", None)], None),
        ([("words", 0.7), ("marked", None), ("words", 0.4)], 0.4),
        ([("words", 0.7), ("guess", None)], 0.0),
    ],
)
def test_the_least_sure_thing_counts_and_a_guess_is_not_sure_at_all(things, confidence):
    views = Views(torch.zeros(1, 2, 3, 8, 8), cameras_around(2).intrinsics)
    selected = tuple(
        Selected(torch.zeros(2, 1, 8, 8), (how, how), confidence=sure)
        for how, sure in things
    )
    edit = EditToJudge(views, views, range(2), (), selected, None, None)
    assert confidence_of(edit) == confidence
