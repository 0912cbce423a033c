"""What most photos show of a thing belongs to it in all."""

import pytest
import torch
from edit3r_select.carrying import agreed
from edit3r_select.photos import OnPhoto, Photos

from edit3r.contract.interfaces import Geometry

SIDE = 64
SNOUT, GROUND = (slice(22, 43), slice(9, 15)), (slice(46, 54), slice(22, 38))


def at_one_place(count: int, measured: float = 1.0) -> Photos:
    """Photos of a wall from one place: each pixel shows what it shows in the other."""
    ones = torch.ones(1, count, SIDE, SIDE)
    placed = torch.ones(1, count, dtype=torch.bool)
    poses = torch.eye(4).expand(1, count, 4, 4)
    geometry = Geometry(poses, ones, measured * ones, placed)
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])
    images = torch.zeros(count, 3, SIDE, SIDE)
    return Photos(images, None, geometry, lens.expand(1, count, 3, 3))


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


BEAR, OTHER = OnPhoto(bear(), "marked"), OnPhoto(other(), "geometry")
GIVEN = OnPhoto(bear(), "given")


@pytest.mark.parametrize(
    ("own", "others", "snout", "ground"),
    [
        # of two photos both hold: what one of them lacks would be of two colours in 3D
        (OTHER, [BEAR], True, True),
        (BEAR, [OTHER], True, True),
        (OTHER, [BEAR, BEAR], True, False),
        (BEAR, [OTHER, OTHER], False, True),
        # what was given is exact
        (OTHER, [GIVEN, *[OTHER] * 4], True, False),
        (GIVEN, [OTHER] * 4, True, False),
        # what was followed by pictures says nothing
        (BEAR, [OnPhoto(other(), "pictures")] * 3, True, False),
    ],
)
def test_patches_are_as_most_photos_have_them(own, others, snout, ground):
    found = dict(enumerate([own, *others]))
    mask = agreed(at_one_place(len(found)), found, set())[0].inside
    for place, wanted in ((SNOUT, snout), (GROUND, ground)):
        assert bool(mask[place].all()) == wanted and bool(mask[place].any()) == wanted


def test_what_was_painted_on_is_outvoted_by_none():
    found = {0: BEAR, 1: OTHER, 2: OTHER}
    assert torch.equal(agreed(at_one_place(3), found, {0})[0].mask, bear())


def test_outlines_stay_for_they_never_lie_at_the_same_pixel():
    mask = agreed(at_one_place(2), {0: OTHER, 1: BEAR}, set())[0].inside
    assert not mask[20, 20:50].any()


def test_where_depth_was_not_measured_the_mask_stays():
    found = agreed(at_one_place(2, measured=0.2), {0: OTHER, 1: BEAR}, set())
    assert torch.equal(found[0].mask, other())
