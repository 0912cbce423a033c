"""Edits carried between views through the geometry."""

import pytest
import torch
from edit3r_optimisers.fusion import OWN_WEIGHT, fuse, nearest_views

from edit3r.testing.scenes import photograph


@pytest.fixture(scope="module")
def scene():
    return photograph(4, (48, 64))


def test_neighbours_are_the_nearest_cameras_without_the_view_itself(scene):
    assert nearest_views(scene.cameras, 0, 2) == [1, 2]
    assert nearest_views(scene.cameras, 3, 9) == [2, 1, 0]


def test_photos_fused_through_the_true_depth_are_the_photo(scene):
    """No edit: what neighbours say of a view must be the view, nearly, where they look at it."""
    fused = fuse(0, [1, 2], scene.views.images[0], scene.depths[0], scene.cameras)
    seen = fused.support > 0.5
    assert seen.float().mean() > 0.6
    assert (fused.image - scene.views.images[0, 0]).abs().mean(0)[seen].mean() < 0.01


def test_where_no_neighbour_looks_the_own_edit_stays(scene):
    fused = fuse(0, [2], scene.views.images[0], scene.depths[0], scene.cameras)
    alone = fused.support < 1e-6
    assert alone.any() and torch.allclose(fused.image[:, alone], scene.views.images[0, 0][:, alone])


def test_disagreeing_edits_are_averaged_by_weight(scene):
    edits = torch.zeros(4, 3, 48, 64)
    edits[1] = 1
    fused = fuse(0, [1], edits, scene.depths[0], scene.cameras)
    exact = fused.support / (fused.support + OWN_WEIGHT)
    assert torch.allclose(fused.image, exact.expand(3, -1, -1), atol=1e-6) and exact.max() > 0.75


def test_what_a_ball_hides_from_a_neighbour_is_not_taken_from_it(scene):
    """Paint the balls in view 1 only; the wall behind them in view 0 must not catch the paint."""
    balls = scene.objects[:, 0].amax(0)
    edits = torch.zeros(4, 3, 48, 64)
    edits[1] = balls[1]
    painted = fuse(0, [1], edits, scene.depths[0], scene.cameras).image[0]
    assert painted[balls[0] == 0].mean() < 0.02 and painted[balls[0] == 1].mean() > 0.5
