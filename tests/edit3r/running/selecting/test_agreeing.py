"""What a photo with a mask of its own shows of a thing belongs to it in the others."""

import torch

from edit3r.kit.geometry.warping import shared_surface
from edit3r.running.selecting.agreeing import ONE_SURFACE, agreed

SIDE = 64


def at_one_place():
    """Two photos of a wall from one place: each pixel shows what it shows in the other."""
    depths, lenses = torch.ones(2, SIDE, SIDE), torch.eye(3).expand(2, 3, 3)
    return shared_surface(depths, lenses, torch.eye(4).expand(2, 4, 4), ONE_SURFACE)


def masks() -> tuple[torch.Tensor, torch.Tensor]:
    """A bear without its snout and with a thin stripe too few; the bear, without the ground that
    the first has.
    """
    bear = torch.zeros(SIDE, SIDE)
    bear[20:44, 8:50] = 1
    carried = bear.clone()
    carried[:, :16] = 0  # the snout
    carried[20] = 0  # its outline lies a pixel lower
    carried[44:56, 20:40] = 1  # the ground
    return carried, bear


def joined(measured=1.0) -> torch.Tensor:
    confidence = torch.full((2, SIDE, SIDE), measured)
    return agreed(*masks(), at_one_place(), confidence)


def test_a_patch_that_is_lacking_is_added_and_nothing_is_taken_away():
    carried, _ = masks()
    found = joined()
    assert found[22:43, 8:16].min() == 1
    assert (found >= carried).all()
    assert found[20, 30] == 0  # outlines never lie at the same pixel


def test_where_depth_was_not_measured_the_mask_stays():
    assert torch.equal(joined(measured=0.2), masks()[0])
