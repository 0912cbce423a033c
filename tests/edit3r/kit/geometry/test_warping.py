import dataclasses

import pytest
import torch
from edit3r_geometry.reconstructor import seen_by_others

from edit3r.contract.interfaces import Geometry
from edit3r.kit.geometry.cameras import unproject
from edit3r.kit.geometry.warping import (
    _better_measured,
    contradicted,
    nearest_views,
    seen_by,
    shared_surface,
    stands_before_others,
)
from edit3r_testing import photograph

SCENE = photograph(2, (48, 64))
INTRINSICS = SCENE.views.intrinsics


@pytest.fixture
def truth():
    registered = torch.ones(1, 2, dtype=torch.bool)
    return Geometry(
        SCENE.cameras.c2w, SCENE.depths, torch.ones_like(SCENE.depths), registered
    )


def test_guesses_before_or_on_what_another_view_measured_are_contradicted(truth):
    depths, confidence = truth.depths.clone(), truth.confidence.clone()
    depths[0, 0, 20:24, 30:32] *= 0.5
    confidence[0, 0, 20:24, 30:34] = 0
    found = contradicted(
        dataclasses.replace(truth, depths=depths, confidence=confidence), INTRINSICS
    )
    assert found[0, 0, 20:24, 30:32].all() and 12 <= found.sum() <= 16
    assert not contradicted(truth, INTRINSICS).any()


def test_what_was_measured_falls_only_where_more_views_see_through_it_than_confirm_it():
    scene = photograph(3, (48, 64))
    depths = scene.depths.clone()
    depths[0, 0, 20:26, 30:36] *= 0.5
    geometry = Geometry(
        scene.cameras.c2w,
        depths,
        torch.ones_like(depths),
        torch.ones(1, 3, dtype=torch.bool),
    )
    found = contradicted(geometry, scene.views.intrinsics)
    assert found[0, 0, 21:25, 31:35].all() and found.sum() < 60


@pytest.mark.parametrize(
    ("guessed_rows", "views", "falls"), [(48, 3, True), (48, 2, False), (20, 3, False)]
)
def test_guesses_of_a_mostly_guessed_view_fall_where_two_better_measured_ones_look(
    guessed_rows, views, falls
):
    """The guesses lie behind what the others measured, so that they hide nothing of it."""
    scene = photograph(views, (48, 64))
    depths, confidence = scene.depths.clone(), torch.ones_like(scene.depths)
    depths[:, 0, :guessed_rows] *= 1.3
    confidence[:, 0, :guessed_rows] = 0
    geometry = Geometry(
        scene.cameras.c2w, depths, confidence, torch.ones(1, views, dtype=torch.bool)
    )
    found = contradicted(geometry, scene.views.intrinsics)[:, 0, :guessed_rows]
    assert (found.float().mean() > 0.8) == falls


def test_views_see_their_own_points_and_most_of_the_others(truth):
    points = unproject(truth.depths, INTRINSICS, truth.c2w).flatten(2, 3)
    assert seen_by(points[:, 1], truth, INTRINSICS, 1).all()
    assert 0.5 < seen_by_others(truth, INTRINSICS).float().mean() < 1


@pytest.mark.parametrize(("factor", "shared"), [(0.5, 0), (1, 1), (2, 0)])
def test_two_views_share_a_surface_only_at_its_depth_before_and_behind_it(
    factor, shared
):
    depths = torch.full((2, 8, 8), 2.0)
    depths[1] *= factor
    k, c2w = torch.eye(3).repeat(2, 1, 1), torch.eye(4).repeat(2, 1, 1)
    k[:, :2, 2] = 0.5
    assert shared_surface(depths, k, c2w, 0.04)[1].float().mean() == shared


def test_a_view_that_is_not_registered_sees_nothing(truth):
    alone = dataclasses.replace(truth, registered=torch.tensor([[True, False]]))
    assert not seen_by_others(alone, INTRINSICS)[:, 0].any()
    assert seen_by_others(alone, INTRINSICS)[:, 1].any()


def test_the_nearest_views_are_those_that_stand_and_look_alike():
    c2w = torch.eye(4).repeat(1, 6, 1, 1)
    c2w[0, :, 0, 3] = torch.arange(6.0)
    c2w[0, 1, :3, :3] = torch.diag(torch.tensor([-1.0, 1, -1]))  # looks back
    nearest = nearest_views(c2w, torch.full((1, 6, 4, 4), 5.0), 2)
    assert nearest[0] == [2, 3] and nearest[4] == [3, 5]
    assert nearest_views(c2w, torch.ones(1, 6, 4, 4), 5)[1] == [0, 2, 3, 4, 5]


def test_what_is_behind_another_camera_hides_nothing_from_it():
    """The second camera stands between the first and what that one sees, or before it."""
    lens = INTRINSICS[:, :2]
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    surfaces = torch.full((1, 2, 48, 64), 4.0)
    points = torch.tensor([0.0, 0.0, 2.0]).expand(1, 2, 1, 1, 3)
    for place, hides in ((5.0, False), (1.0, True)):
        c2w[:, 1, 2, 3] = place
        found = stands_before_others(points, surfaces, lens, c2w)
        assert bool(found[0, 0]) == hides


def test_a_mostly_guessed_view_yields_to_clearly_more_measured_ones_alone():
    """A tenth more is not clearly more."""
    scene = photograph(3, (48, 64))
    confidence = torch.zeros_like(scene.depths)
    placed = torch.ones(1, 3, dtype=torch.bool)
    geometry = Geometry(scene.cameras.c2w, scene.depths, confidence, placed)
    confidence[0, 1:, :5] = 1
    assert not _better_measured(geometry).any()
    confidence[0, 1:, :16] = 1
    assert _better_measured(geometry)[0, 0].tolist() == [False, True, True]
