"""Geometry of the unedited photos is found once, and not believed where it says nothing."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.errors import MatchingError, PluginError
from edit3r.contract.interfaces import Geometry, MatchesCorrected
from edit3r.running.geometry import find_geometry, geometry_of, lies_flat
from edit3r_testing.scenes import photograph

SCENE = photograph(3, (48, 64), batch=2)


def true_geometry(scene=SCENE):
    placed = torch.ones(scene.depths.shape[:2], dtype=torch.bool)
    sure = torch.ones_like(scene.depths)
    return Geometry(scene.cameras.c2w, scene.depths, sure, placed)


class Knows:
    """A matcher that knows the answer, or that there is none."""

    def __init__(self, answer):
        self.answer = answer

    def match(self, views):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


class Levels(Knows, MatchesCorrected):
    """One that measures depth on corrected photos; keeps those that it was given."""

    def match_corrected(self, views, corrected):
        self.corrected = [*getattr(self, "corrected", []), corrected]
        return self.answer


def test_depth_is_measured_on_the_corrected_photos_where_a_matcher_can():
    views = SCENE.views
    corrected = replace(views, images=0.5 * views.images)
    levels = Levels(true_geometry())
    find_geometry(levels, views)
    assert not hasattr(levels, "corrected")
    find_geometry(levels, views, corrected)
    assert [one is corrected for one in levels.corrected] == [True]
    assert find_geometry(Knows(true_geometry()), views, corrected).problem == ""


def test_what_a_matcher_finds_is_taken_where_the_photos_lie_apart():
    located = find_geometry(Knows(true_geometry()), SCENE.views)
    assert located.problem == "" and located.trusted() is located.geometry


def test_a_camera_that_stood_still_tells_no_depth_however_much_was_measured():
    true = true_geometry()
    near = true.c2w.clone()
    near[..., :3, 3] *= 0.01  # some thousandths of the distance
    near[..., :3, :3] = torch.eye(3)
    with pytest.warns(UserWarning, match="nearly the same place.*move aside"):
        still = geometry_of(Knows(replace(true, c2w=near)), SCENE.views)
    assert still is None


def test_one_scene_of_a_batch_whose_camera_stood_still_is_told():
    true = true_geometry()
    c2w = true.c2w.clone()
    c2w[1] = torch.eye(4)
    located = find_geometry(Knows(replace(true, c2w=c2w)), SCENE.views)
    assert located.geometry is not None and "nearly the same place" in located.problem


def test_two_photos_from_one_place_beside_a_third_are_not_flat():
    true = true_geometry()
    c2w, depths = true.c2w.clone(), true.depths.clone()
    c2w[:, 1, :3, 3] = 0  # turned alone: one homography explains these two
    pair = replace(true, c2w=c2w, depths=depths)
    alone = true.registered & torch.tensor([True, True, False])
    assert lies_flat(replace(pair, registered=alone), SCENE.views)
    assert not lies_flat(pair, SCENE.views)


def test_one_plane_is_told_from_things_in_depth():
    true = true_geometry()
    facing = torch.eye(4).expand_as(true.c2w).clone()
    facing[..., 0, 3] = 0.1 * torch.arange(3)
    card = replace(true, c2w=facing, depths=torch.full_like(true.depths, 2.0))
    assert lies_flat(card, SCENE.views) and not lies_flat(true, SCENE.views)
    assert not lies_flat(None, SCENE.views)
    alone = torch.zeros_like(card.registered)
    assert not lies_flat(replace(card, registered=alone), SCENE.views)


def test_photos_that_cannot_be_placed_are_told_and_selected_without():
    with pytest.warns(UserWarning, match="not where they were taken: too few points"):
        found = geometry_of(Knows(MatchingError("too few points")), SCENE.views)
    assert found is None


def test_one_scene_of_a_batch_keeps_its_own_geometry():
    both = replace(true_geometry(), intrinsics=SCENE.views.intrinsics)
    second = both.scene(1)
    assert torch.equal(second.depths, both.depths[1:])
    assert second.intrinsics.shape[0] == len(second.c2w) == 1


def seen(**fields):
    return replace(true_geometry(), **fields)


def posed(row, column, value):
    """The true poses with one number of the second view's changed."""
    c2w = true_geometry().c2w.clone()
    c2w[:, 1, row, column] = value
    return seen(c2w=c2w)


PLACED = true_geometry().registered
LENS = SCENE.views.intrinsics


@pytest.mark.parametrize(
    "answer, said",
    [
        (seen(depths=None), "must return depths as a tensor, got NoneType"),
        (seen(depths=torch.ones(())), "must return depths of shape"),
        (seen(confidence=3 * true_geometry().confidence), r"confidence in \[0, 1\]"),
        (seen(registered=PLACED.float()), "must return registered in torch.bool"),
        (seen(registered=~PLACED), "must place view 0 and another one"),
        (
            seen(registered=PLACED & torch.tensor([False, True, True])),
            "must place view 0 and another one",
        ),
        (seen(c2w=0 * true_geometry().c2w), "a rotation; one scales or is singular"),
        (seen(c2w=-true_geometry().c2w), "a rotation; one mirrors"),
        (posed(0, 3, 1e20), "where depths reach; one is 1e[+]20 away"),
        (posed(3, 0, 5.0), "whose last row is 0, 0, 0, 1"),
        (posed(0, 0, float("nan")), "returned c2w with 2 of 96 values not finite"),
        (seen(c2w=true_geometry().c2w.roll(1, 1)), "in the frame of view 0"),
        (seen(intrinsics=0 * LENS), "must return focal lengths above 0"),
        (seen(intrinsics=LENS[:, :1]), "must return intrinsics of shape"),
        (seen(fov_range=5), "must return fov_range as two angles"),
        (ValueError("no luck"), "raised ValueError: no luck"),
        (None, "must return edit3r.contract.interfaces.Geometry, got NoneType"),
        (
            replace(true_geometry(), depths=true_geometry().depths.double()),
            "must return depths in torch.float32",
        ),
        (true_geometry().scene(0), r"must return c2w of shape \[2, 3, 4, 4\]"),
    ],
)
def test_a_matcher_that_breaks_its_contract_is_named(answer, said):
    with pytest.raises(PluginError, match=said):
        find_geometry(Knows(answer), SCENE.views)
