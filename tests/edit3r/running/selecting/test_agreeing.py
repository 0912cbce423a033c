"""What a photo with a mask of its own shows of a thing belongs to it in the others."""

import torch

from edit3r.contract.interfaces import MatchedGeometry
from edit3r.running.selecting.agreeing import agreed

SIDE = 64


def at_one_place(measured=1.0) -> MatchedGeometry:
    """Two photos of a wall from one place: each pixel shows what it shows in the other."""
    return MatchedGeometry(
        c2w=torch.eye(4).expand(1, 2, 4, 4),
        depths=torch.ones(1, 2, SIDE, SIDE),
        confidence=torch.full((1, 2, SIDE, SIDE), measured),
        registered=torch.ones(1, 2, dtype=torch.bool),
    )


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
    lens = torch.eye(3).expand(1, 2, 3, 3)
    carried, bear = masks()
    return agreed(carried, bear, (0, 1), at_one_place(measured), lens)


def test_a_patch_that_is_lacking_is_added_and_nothing_is_taken_away():
    carried, _ = masks()
    found = joined()
    assert found[22:43, 8:16].min() == 1
    assert (found >= carried).all()
    assert found[20, 30] == 0  # outlines never lie at the same pixel


def test_where_depth_was_not_measured_the_mask_stays():
    assert torch.equal(joined(measured=0.2), masks()[0])
