"""Words are looked up where they are found most surely, and other photos confirm it."""

from dataclasses import replace

import pytest
import torch
from edit3r_select.confirming import SURER, UNCONFIRMED, surest

from edit3r.contract.interfaces import as_proposal
from edit3r.kit.geometry.cameras import pixel_grid


def thing(confidence, row):
    """A square of 4 pixels in an image of 16, at a row of four places."""
    mask = torch.zeros(16, 16)
    mask[4 * row : 4 * row + 4, 4:8] = 1
    return replace(as_proposal(mask), confidence=confidence)


def still(view, other):
    """Photos from one place: each pixel lies where it lay."""
    return pixel_grid((16, 16), torch.zeros(1)), torch.ones(16, 16, dtype=torch.bool)


def hidden(view, other):
    grid, same = still(view, other)
    return grid, ~same


def unknown(view, other):
    return None


@pytest.mark.parametrize(
    ("first", "other", "shared", "view", "confidence"),
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
    first, other, shared, view, confidence
):
    found = {0: [thing(*one) for one in first], 1: [thing(*one) for one in other]}
    best, kept = surest({v: tuple(some) for v, some in found.items()}, 0, shared)
    assert best == view
    assert (
        confidence is None
        if not kept
        else kept[0].confidence == pytest.approx(confidence)
    )


def test_what_the_others_show_wins_over_what_none_of_them_sees():
    """A thing that one photo takes with its plinth is confirmed in part, and by another photo; a
    dark corner is seen by none.
    """
    corner, body = torch.zeros(16, 16), torch.zeros(16, 16)
    corner[:3, :6] = 1
    body[8:12, 4:10] = 1
    more = body.clone()
    more[8:16, 4:12] = 1
    there, with_plinth, dark = map(as_proposal, (body, more, corner))

    def without_corner(view, other):
        grid, same = still(view, other)
        return grid, same & (corner == 0)

    found = {
        0: (replace(there, confidence=0.4), replace(dark, confidence=0.3)),
        1: (replace(there, confidence=0.3),),
        2: (replace(with_plinth, confidence=0.3),),
    }
    best, kept = surest(found, 0, without_corner)
    assert best == 0
    assert [one.confidence for one in kept] == [pytest.approx(0.366, abs=0.01), 0.3]


def test_of_near_ones_that_inside_of_the_photo_comes_first():
    edge, inside = torch.zeros(16, 16), torch.zeros(16, 16)
    edge[:8, :4] = 1
    inside[6:10, 6:10] = 1
    found = {0: tuple(replace(as_proposal(m), confidence=0.5) for m in (edge, inside))}
    _, kept = surest(found, 0, unknown)
    assert torch.equal(kept[0].soft_mask, inside)


def test_what_another_photo_confirms_comes_before_a_surer_one_that_none_sees():
    beside, seen = torch.zeros(16, 16), torch.zeros(16, 16)
    beside[2:6, 2:6] = 1
    seen[9:13, 9:13] = 1

    def without_beside(view, other):
        grid, same = still(view, other)
        return grid, same & (beside == 0)

    surer, confirmed = (
        replace(as_proposal(one), confidence=0.5) for one in (beside, seen)
    )
    found = {0: (surer, replace(confirmed, confidence=0.45)), 1: (confirmed,)}
    _, kept = surest(found, 0, without_beside)
    assert [one.confidence for one in kept] == [0.45, 0.5]
    alone = {0: found[0], 1: (confirmed,)}  # nobody knows of either: the surer one
    assert [one.confidence for one in surest(alone, 0, unknown)[1]] == [0.5, 0.45]
