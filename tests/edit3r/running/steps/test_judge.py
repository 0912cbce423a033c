"""What else than its pictures speaks against a scene."""

import re

import pytest

from edit3r.contract.types import Views
from edit3r.running.judging.edit_verdict import EditMeasures, judge_edit
from edit3r.running.scene import Scene
from edit3r.running.steps.judge import doubt_of
from edit3r_testing.scenes import cameras_around

BLACK = judge_edit(EditMeasures((1.0,), 1.0, faults=("a black picture",)))


@pytest.mark.parametrize(
    "found, said",
    [
        ({"lenses": (31.0, 75.2)}, "from 31 to 75 degrees.*--fov"),
        ({"flat": True}, "one plane.*--fov"),
        ({"edit_verdict": BLACK}, "2D edits do not show"),
    ],
)
def test_a_scene_is_at_most_fair_where_photos_do_not_tell_or_edits_are_none(
    found, said
):
    import torch

    views = Views(torch.zeros(1, 2, 3, 8, 8), cameras_around(2).intrinsics)
    assert doubt_of(Scene(views, views)) is None
    doubt = doubt_of(Scene(views, views, **found))
    assert doubt.best == "fair" and re.search(said, doubt.clause)
