"""Only what has a colour changes, with the shade of it that hangs together with it."""

import torch

from edit3r.contract.instructions import Colour
from edit3r.running.selecting.near_colour import near_colour

WINE, BORDEAUX = (0.62, 0.13, 0.17), (0.45, 0.06, 0.15)
RED, DARK_RED, GREY = (0.8, 0.1, 0.1), (0.28, 0.045, 0.04), (0.5, 0.5, 0.5)
SHINE, DARK_PINK = (1.0, 0.42, 0.5), (0.55, 0.18, 0.26)


def found(*pieces):
    """Where a grey picture with squares (first column, columns, colour) is near red."""
    image = torch.tensor(GREY)[:, None, None].repeat(1, 40, 80)
    for first, count, colour in pieces:
        image[:, 10:30, first : first + count] = torch.tensor(colour)[:, None, None]
    pair = torch.stack((image.flip(-1), image))  # views that differ
    near = near_colour(torch.ones(2, 40, 80), pair, Colour("red", RED)) > 0.5
    assert torch.equal(near[0], near[1].flip(-1))
    return near[1, 20]


def test_shade_at_the_rim_of_what_has_the_colour_has_it_too():
    columns = found((10, 24, RED), (34, 6, DARK_RED))
    assert columns[12:38].all() and not columns[42:].any()


def test_a_highlight_on_what_has_the_colour_has_it_too():
    columns = found((10, 24, RED), (34, 6, SHINE))
    assert columns[12:38].all()
    other = found((10, 24, RED), (34, 6, DARK_PINK))
    assert other[12:32].all() and not other[36:].any()


def test_what_is_mostly_another_shade_or_stands_alone_does_not():
    columns = found((5, 8, RED), (13, 20, DARK_RED), (50, 20, DARK_RED))
    assert columns[6:12].all() and not columns[15:].any()


def test_within_a_thing_all_of_its_own_shade_has_the_colour():
    """Half of a thing was taken where its red is not quite the name's."""
    image = torch.tensor(GREY)[:, None, None].repeat(1, 40, 80)
    for first, colour in ((5, WINE), (25, BORDEAUX), (50, WINE)):
        image[:, 10:30, first : first + 15] = torch.tensor(colour)[:, None, None]
    thing = torch.zeros(1, 40, 80)
    thing[:, 10:30, 5:40] = 1
    near = near_colour(thing, image[None], Colour("red", RED))[0, 20] > 0.5
    assert near[7:18].all() and near[27:38].all()
    assert not near[50:].any(), "beside the thing"
