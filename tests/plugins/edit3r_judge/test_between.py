"""What no photo measured counts where it is seen half-way: patterned, and from no neighbour."""

import math
from dataclasses import replace

import pytest
import torch
from edit3r_judge.between import guessed_between

from edit3r.contract.interfaces import Geometry
from edit3r_testing import photograph

SCENE = photograph(3, (48, 64))
PATTERN = torch.rand(1, 3, 3, 48, 64, generator=torch.Generator().manual_seed(0))
BLANK = torch.full_like(PATTERN, 0.4)


def shares(guessing, images=PATTERN, registered=(True, True, True)):
    """What is guessed half-way where those photos measured nothing in their left halves."""
    confidence = torch.ones_like(SCENE.depths)
    confidence[:, list(guessing), :, :32] = 0
    geometry = Geometry(
        SCENE.cameras.c2w, SCENE.depths, confidence, torch.tensor([registered])
    )
    return guessed_between(geometry, replace(SCENE.views, images=images))[0].tolist()


def test_what_no_photo_measured_counts_by_its_share_of_the_picture():
    assert all(0.25 < share < 0.6 for share in shares([0, 1, 2]))


@pytest.mark.parametrize(
    ("guessing", "images"), [([], PATTERN), ([0], PATTERN), ([0, 1, 2], BLANK)]
)
def test_nothing_counts_that_a_neighbour_measured_or_that_is_blank(guessing, images):
    assert max(shares(guessing, images)) < 0.1


def test_what_no_photo_shows_half_way_counts_though_all_was_measured():
    """Cameras that look aside, each its own way: between them lies a hole."""
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    for view, angle in enumerate((-0.7, 0.7)):
        c2w[0, view, :3, :3] = rotation_about_y(angle)
        c2w[0, view, 0, 3] = 0.2 * view
    ones = torch.ones(1, 2, 48, 64)
    geometry = Geometry(c2w, 3 * ones, ones, torch.ones(1, 2, dtype=torch.bool))
    photos = replace(SCENE.views.select([0, 1]), images=BLANK[:, :2])
    assert all(share > 0.3 for share in guessed_between(geometry, photos)[0].tolist())


def rotation_about_y(angle):
    cos, sin = math.cos(angle), math.sin(angle)
    return torch.tensor([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]])


def test_a_photo_that_was_not_placed_is_unknown_and_helps_no_other():
    found = shares([0, 1], registered=(True, True, False))
    assert found[2] == 1 and 0.25 < found[0] == found[1] < 0.6


def test_a_blank_surface_hides_the_guessed_pattern_behind_it():
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, 0, 3] = 0.01
    depths = torch.ones(1, 2, 48, 64)
    depths[:, 1] = 4
    images = torch.cat((BLANK[:, :1], PATTERN[:, 1:2]), 1)
    geometry = Geometry(
        c2w, depths, torch.zeros_like(depths), torch.ones(1, 2, dtype=torch.bool)
    )
    photos = replace(SCENE.views.select([0, 1]), images=images)
    assert max(guessed_between(geometry, photos)[0].tolist()) < 0.1
