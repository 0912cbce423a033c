"""Clicks at other places of a thing say whether it is one thing to the network."""

import pytest
import torch

from edit3r.contract.interfaces import as_proposal
from edit3r.running.judging.elsewhere import meant_elsewhere
from edit3r.running.selecting.select import Reading, Selected

PHOTO = torch.rand(1, 3, 40, 60)
WALL = torch.ones(40, 60)
FOX, HEAD = torch.zeros(2, 40, 60)
FOX[5:35, 10:50] = 1
HEAD[5:20, 10:50] = 1
CLICKED = Selected(FOX[None, None], ("marked",), readings=(Reading(0, FOX, 1.0, 1),))


@pytest.mark.parametrize(
    ("answers", "expected"),
    [
        ((FOX, WALL), True),
        ((WALL, FOX), False),  # known, and never the surest
        ((WALL, HEAD), None),  # not known: drawn by hand, perhaps
        ((), None),
    ],
)
def test_a_thing_is_one_where_a_click_elsewhere_means_it_too(answers, expected):
    ask = lambda photo, place: [as_proposal(one) for one in answers]  # noqa: E731
    assert meant_elsewhere(PHOTO, [CLICKED], ask) is expected


def test_one_place_that_means_it_is_enough_and_ends_the_questions():
    asked = []

    def ask(photo, place):
        asked.append(place)
        one = FOX if len(asked) == 3 else WALL
        return [as_proposal(one), as_proposal(FOX)]

    assert meant_elsewhere(PHOTO, [CLICKED], ask) is True
    assert len(set(asked)) == len(asked) == 3
    assert all(FOX[int(y * 40), int(x * 60)] for x, y in asked)


def test_what_was_not_clicked_on_is_not_asked_for():
    named = Selected(FOX[None, None], ("words",), readings=CLICKED.readings)
    assert meant_elsewhere(PHOTO, [named], lambda *_: 1 / 0) is None
