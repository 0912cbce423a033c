"""What most photos show of a thing belongs to it in all."""

import pytest
import torch
from edit3r_select.agreeing import (
    CARRIED,
    EXACT,
    FOUND,
    ONE_SURFACE,
    agreed,
    of_itself,
    told_by,
)

from edit3r.kit.geometry.warping import shared_surface

SIDE = 64
SNOUT, GROUND = (slice(22, 43), slice(9, 15)), (slice(46, 54), slice(22, 38))


def at_one_place():
    """Two photos of a wall from one place: each pixel shows what it shows in the other."""
    depths, lenses = torch.ones(2, SIDE, SIDE), torch.eye(3).expand(2, 3, 3)
    return shared_surface(depths, lenses, torch.eye(4).expand(2, 4, 4), ONE_SURFACE)


def bear() -> torch.Tensor:
    mask = torch.zeros(SIDE, SIDE)
    mask[20:44, 8:50] = 1
    return mask


def other() -> torch.Tensor:
    """The bear without its snout, with the ground, and with its outline a pixel lower."""
    mask = bear()
    mask[:, :16] = 0
    mask[44:56, 20:40] = 1
    mask[20] = 0
    return mask


def joined(own, *others, measured=1.0) -> torch.Tensor:
    """What is left of a mask, each with how much it counts."""
    confidence = torch.full((2, SIDE, SIDE), measured)
    told = [told_by(of_itself(*one), at_one_place(), confidence) for one in others]
    return agreed(of_itself(*own), told)


@pytest.mark.parametrize(
    ("own", "others", "snout", "ground"),
    [
        # of two photos both hold: what one of them lacks would be of two colours in 3D
        ((other(), CARRIED), [(bear(), FOUND)], True, True),
        ((bear(), FOUND), [(other(), CARRIED)], True, True),
        # of four the most, and the marked one counts twice
        ((other(), CARRIED), [(bear(), FOUND), (bear(), CARRIED)], True, False),
        ((bear(), FOUND), [(other(), CARRIED)] * 3, False, True),
        ((bear(), FOUND), [(other(), CARRIED)] * 2, True, True),
        # what was given is exact
        ((other(), CARRIED), [(bear(), EXACT)], True, False),
        ((other(), CARRIED), [(bear(), EXACT), *[(other(), CARRIED)] * 4], True, False),
    ],
)
def test_patches_are_as_most_photos_have_them(own, others, snout, ground):
    found = joined(own, *others) > 0.5
    for place, wanted in ((SNOUT, snout), (GROUND, ground)):
        assert bool(found[place].all()) == wanted and bool(found[place].any()) == wanted


def test_outlines_stay_for_they_never_lie_at_the_same_pixel():
    assert not joined((other(), CARRIED), (bear(), FOUND))[20, 20:50].any()


def test_where_depth_was_not_measured_the_mask_stays():
    found = joined((other(), CARRIED), (bear(), FOUND), measured=0.2)
    assert torch.equal(found, other())


@pytest.mark.parametrize(("column", "added"), [(2, True), (8, False)])
def test_what_the_border_cuts_is_told_by_a_photo_that_shows_it(column, added):
    """Of three photos one has the snout; the marked ones end before it, at the border or not."""
    marked = torch.zeros(SIDE, SIDE)
    marked[20:44, column + 3 : 50] = 1
    whole = marked.clone()
    whole[20:44, column : column + 3] = 1
    found = joined((marked, FOUND), (marked, FOUND), (whole, CARRIED)) > 0.5
    assert bool(found[24:40, column : column + 3].all()) == added
