"""Guesses that would hide, between two photos, what was measured there are moved away."""

from dataclasses import replace

import pytest
import torch
from edit3r_model.guesses import BEFORE, STEP, pushed_back

from edit3r.contract.interfaces import Geometry

SIZE, WALL = (24, 32), 2.0
LENS = torch.tensor([[1.0, 0, 0.5], [0, 4 / 3, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
WIDE_LENS = torch.tensor([[1.0, 0, 0.5], [0, 24, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)


@pytest.fixture
def wall():
    """A wall that two cameras beside each other measured, but for a patch of the first."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 0.2
    depths = torch.full((1, 2, *SIZE), WALL)
    confidence = torch.ones_like(depths)
    confidence[0, 0, 8:16, 12:20] = 0
    return Geometry(c2w, depths, confidence, torch.ones(1, 2, dtype=torch.bool))


def guessing(wall, depth):
    return replace(wall, depths=wall.depths.where(wall.confidence > 0, depth))


def test_a_guess_before_a_measured_wall_goes_back_to_it(wall):
    result = pushed_back(guessing(wall, 1.5), LENS)
    patch = result.depths[wall.confidence == 0]
    assert (patch >= (1 - BEFORE) * WALL).all() and (patch < STEP * WALL).all()
    assert torch.equal(
        result.depths[wall.confidence > 0], wall.depths[wall.confidence > 0]
    )


@pytest.mark.parametrize("view, guess, strip", [(0, 80, 32), (1, 15, 63)])
def test_a_guess_moves_that_hides_something_from_the_other_photo_alone(
    view, guess, strip
):
    """A quarter of the way from there, the guess stands three pixels beside the strip."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 0.75
    depths = torch.full((1, 2, 4, 96), WALL)
    depths[0, view, :, guess] = 1.5
    confidence = torch.zeros_like(depths)
    confidence[0, 1 - view, :, strip] = 1
    registered = torch.ones(1, 2, dtype=torch.bool)
    result = pushed_back(Geometry(c2w, depths, confidence, registered), WIDE_LENS)
    assert (result.depths[0, view, :, guess] > 1.5).all()


@pytest.mark.parametrize("depth", [WALL, 1.5 * WALL])
def test_a_guess_that_hides_nothing_stays(wall, depth):
    before = guessing(wall, depth)
    assert torch.equal(pushed_back(before, LENS).depths, before.depths)


def test_a_guess_that_would_have_to_go_far_stays(wall):
    before = guessing(wall, WALL / 4)
    assert torch.equal(pushed_back(before, LENS).depths, before.depths)


def test_what_was_measured_stays_before_what_was_measured(wall):
    before = replace(guessing(wall, 1.5), confidence=torch.ones_like(wall.depths))
    assert torch.equal(pushed_back(before, LENS).depths, before.depths)


def test_a_photo_without_a_place_moves_nothing(wall):
    before = replace(guessing(wall, 1.5), registered=torch.tensor([[True, False]]))
    assert torch.equal(pushed_back(before, LENS).depths, before.depths)
