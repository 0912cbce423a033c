"""Words are looked up where they are found most surely, and each photo keeps what it finds."""

from dataclasses import replace

import pytest
import torch
from edit3r_select.naming import (
    SPANS,
    SURER,
    UNCONFIRMED,
    _on_every_photo,
    looked_up,
    numbered,
    taken_of,
)
from edit3r_select.photos import Named, OnPhoto, Photos

from edit3r.contract.interfaces import (
    SUBJECT,
    SURE,
    MaskLogits,
    Proposal,
    Segmenter,
    Selection,
)
from edit3r.kit.geometry.cameras import pixel_grid


def thing(confidence, row):
    """A square of 4 pixels in an image of 16x32, at a row of four places."""
    mask = torch.zeros(16, 32)
    mask[4 * row : 4 * row + 4, 4:8] = 1
    return Proposal(mask, confidence)


class Finds(Segmenter):
    """Finds on each photo, told by its brightness, what it was told to."""

    def __init__(self, *found):
        self.found, self.box = found, None

    def words(self, image, text):
        if text == SUBJECT:
            return (thing(1.0, 3),)
        return tuple(thing(*one) for one in self.found[int(image[0, 0, 0])])

    def masks(self, image, clicks, box=None, before=None):
        self.box = box
        return MaskLogits(torch.full((1, 16, 32), 4.0))


class FromOnePlace(Photos):
    """Each pixel lies where it lay; where the other photo shows the same is told."""

    sees = None

    def shared(self, view, source, tolerance=0.0):
        if self.sees is None:
            return None
        same = torch.full((16, 32), self.sees)
        return pixel_grid((16, 32), torch.zeros(1)), same


def photos(sees, *found):
    count = len(found)
    images = torch.arange(count).view(count, 1, 1, 1).expand(count, 3, 16, 32).float()
    made = FromOnePlace(images, Finds(*found))
    object.__setattr__(made, "sees", sees)
    return made


STILL, HIDDEN, UNKNOWN = True, False, None


@pytest.mark.parametrize(
    ("first", "other", "sees", "view", "confidence"),
    [
        ([(0.5, 0)], [(0.5, 0)], STILL, 0, 0.5),  # confirmed
        ([(0.6, 0)], [], STILL, 0, 0.6 * UNCONFIRMED),  # seen there, and nothing
        ([(0.6, 0)], [], HIDDEN, 0, 0.6),  # not seen there
        ([(0.6, 0)], [], UNKNOWN, 0, 0.6),  # nobody knows
        ([(0.6, 0), (0.5, 2)], [(0.5, 2)], STILL, 0, 0.5),  # the confirmed one wins
        ([], [(0.5, 1)], HIDDEN, 1, 0.5),  # only the other shows it
        # surer there, and this photo keeps its own
        ([(0.3, 0)], [(0.3 * SURER + 0.01, 0)], UNKNOWN, 1, 0.3),
        ([(0.3, 0)], [(0.3 * SURER - 0.01, 0)], UNKNOWN, 0, 0.3),  # hardly surer
    ],
)
def test_the_surest_photo_is_taken_and_the_others_have_a_say(
    first, other, sees, view, confidence
):
    named = looked_up(photos(sees, first, other), Selection(words="box"))
    assert named.candidates[0].view == view
    assert named.confidence == pytest.approx(confidence)


def rows(named):
    """The row of squares in which each photo's own mask lies."""
    return {
        view: int(one.mask.any(1).nonzero()[0]) // 4
        for view, one in named.found.items()
    }


@pytest.mark.parametrize(
    ("sees", "first", "other", "own"),
    [
        # a horse on each of two photos, and one is surer
        (UNKNOWN, [(0.18, 0)], [(0.46, 2)], {0: 0, 1: 2}),
        # what the surer photo shows is the second thing of that name here
        (STILL, [(0.4, 0), (0.3, 2)], [(0.6, 2)], {0: 2, 1: 2}),
        # none of it is what the surer photo shows here: it is carried
        (STILL, [(0.2, 0)], [(0.6, 2)], {1: 2}),
        (HIDDEN, [(0.2, 0)], [(0.6, 2)], {0: 0, 1: 2}),
    ],
)
def test_a_photo_keeps_its_own_finding_beside_a_surer_one(sees, first, other, own):
    named = looked_up(photos(sees, first, other), Selection(words="horse"))
    assert rows(named) == own


@pytest.mark.parametrize(
    ("sees", "confidence", "told"),
    [
        # a table that is surely there, and something else on the first photo
        (UNKNOWN, 0.3, 1),
        (HIDDEN, 0.3, 1),
        (STILL, 0.8, 0),  # the same place on both
    ],
)
def test_what_no_photo_confirms_is_as_sure_as_the_least(sees, confidence, told):
    first, other = [(0.3, 2)], [(0.8, 2)]
    named = looked_up(photos(sees, first, other), Selection(words="table"))
    assert rows(named) == {0: 2, 1: 2}
    assert named.confidence == pytest.approx(confidence)
    assert sum(
        "photo 1 with a confidence of only 30%" in w for w in named.warnings
    ) == (told)


def test_more_or_less_of_a_named_thing_is_asked_of_the_box_around_it():
    asked = photos(UNKNOWN, [(0.3, 1)])
    named = looked_up(asked, Selection(words="box"))
    assert asked.segmenter.box == (4 / 32, 4 / 16, 4 / 32, 4 / 16)
    first, other = named.candidates
    assert first.score == pytest.approx(0.3)
    assert other.mask.all() and other.score <= 0.3  # no surer than the thing


def test_candidates_differ_show_something_and_are_three_at_most():
    def bar(start, stop=None):
        mask = torch.zeros(4, 12)
        mask[1, start : stop or start + 2] = 1
        return mask

    shown = [bar(0), bar(0, 0), bar(0), bar(2), bar(4), bar(6)]
    options = numbered(2, [(mask, 0.9 - 0.1 * n) for n, mask in enumerate(shown)])
    assert [(one.view, one.number) for one in options] == [(2, 1), (2, 2), (2, 3)]
    assert all(torch.equal(options[n].mask, shown[k]) for n, k in enumerate((0, 3, 4)))
    assert [one.score for one in options] == pytest.approx([0.9, 0.6, 0.5])
    assert [taken_of(options, wanted).number for wanted in (1, 2, 3, 9)] == [1, 2, 3, 3]
    assert len(numbered(0, [(bar(0, 0), 0.5), (bar(0, 0), 0.4)])) == 1


@pytest.mark.parametrize("side", ["top", "bottom", "left", "right"])
@pytest.mark.parametrize(("share", "goes_on"), [(SPANS, False), (SPANS + 0.1, True)])
def test_what_goes_on_beyond_the_border_is_looked_for_on_each_photo(
    side, share, goes_on
):
    mask = torch.zeros(10, 20)
    rows = slice(0, 1) if side == "top" else slice(9, 10)
    columns = slice(0, 1) if side == "left" else slice(19, 20)
    if side in ("top", "bottom"):
        mask[rows, : round(20 * share)] = 1
    else:
        mask[: round(10 * share), columns] = 1
    found = (Proposal(mask, 0.9),)
    named = Named({1: OnPhoto(mask, "words")}, 0.9, 0.9)
    table = Selection(words="table")
    assert _on_every_photo(table, found, named, 1) == goes_on
    unsure = replace(named, confidence=SURE - 0.01)
    assert not _on_every_photo(table, found, unsure, 1)


def test_an_unsure_word_is_looked_for_on_three_photos():
    first, later = [(0.3, 0)], [(0.9, 1)]
    named = looked_up(photos(UNKNOWN, first, [], [], later), Selection(words="box"))
    assert list(named.found) == [0]
    named = looked_up(photos(UNKNOWN, first, [], later, []), Selection(words="box"))
    assert rows(named) == {0: 0, 2: 1}
