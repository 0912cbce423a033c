"""Words are looked up where they are found most surely, and other photos confirm it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import as_proposal
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r.running.selecting.confirming import SURER, UNCONFIRMED, surest


def thing(surety, row):
    """A square of 4 pixels in an image of 16, at a row of four places."""
    mask = torch.zeros(16, 16)
    mask[4 * row : 4 * row + 4, 4:8] = 1
    return replace(as_proposal(mask), surety=surety)


def still(view, other):
    """Photos from one place: each pixel lies where it lay."""
    return pixel_grid((16, 16), torch.zeros(1)), torch.ones(16, 16, dtype=torch.bool)


def hidden(view, other):
    grid, same = still(view, other)
    return grid, ~same


def unknown(view, other):
    return None


@pytest.mark.parametrize(
    ("first", "other", "shared", "view", "surety"),
    [
        ([(0.5, 0)], [(0.5, 0)], still, 0, 0.5),  # confirmed
        ([(0.6, 0)], [], still, 0, 0.6 * UNCONFIRMED),  # seen there, and nothing
        ([(0.6, 0)], [], hidden, 0, 0.6),  # not seen there
        ([(0.6, 0)], [], unknown, 0, 0.6),  # nobody knows
        ([(0.6, 0), (0.5, 2)], [(0.5, 2)], still, 0, 0.5),  # the confirmed one wins
        ([], [(0.5, 1)], hidden, 1, 0.5),  # only the other shows it
        ([(0.3, 0)], [(0.3 * SURER + 0.01, 0)], unknown, 1, 0.3 * SURER + 0.01),
        ([(0.3, 0)], [(0.3 * SURER - 0.01, 0)], unknown, 0, 0.3),  # hardly surer
        ([], [], still, 0, None),
    ],
)
def test_the_surest_photo_is_taken_and_the_others_have_a_say(
    first, other, shared, view, surety
):
    found = {0: [thing(*one) for one in first], 1: [thing(*one) for one in other]}
    best, kept = surest({v: tuple(some) for v, some in found.items()}, 0, shared)
    assert best == view
    assert surety is None if not kept else kept[0].surety == pytest.approx(surety)
