"""What is said of the selection: the least confident thing decides, and what was given is given."""

import re
from dataclasses import replace

import pytest
import torch

from edit3r.contract.instructions import Colour, Instruction, Target
from edit3r.contract.interfaces import Candidate, Selected
from edit3r.running.records import SelectedRegions
from edit3r.running.selecting.verdict import verdict_on_selection

MASKS = torch.zeros(2, 1, 8, 8)
OTHERS = tuple(Candidate(0, MASKS[0, 0], 0.5, number) for number in (1, 2))
GIVEN = Selected(MASKS, ("given", "given"))
SURE = Selected(MASKS, ("words", "geometry"), confidence=0.9, called="fox")
UNSURE = Selected(
    MASKS, ("words", "not found"), confidence=0.4, called="cup", candidates=OTHERS
)
GUESS = Selected(MASKS, ("guess", "geometry"), confidence=0.25)
TAKEN = Selected(
    MASKS,
    ("words", "geometry"),
    confidence=0.4,
    called="cup",
    candidates=OTHERS,
    taken=2,
)


@pytest.mark.parametrize(
    ("things", "label", "confidence", "said"),
    [
        ([GIVEN], "given", None, "what is marked"),
        ([SURE], "found", 0.9, "fox, confidence 90%"),
        ([GIVEN, SURE, UNSURE], "question", 0.4, "fox, confidence 90%; cup"),
        ([UNSURE], "question", 0.4, "not found on photo 2; look.*--candidate 2 takes"),
        (
            [SURE, GUESS],
            "question",
            0.25,
            "most, confidence 25%; if it is another thing, click",
        ),
        ([TAKEN], "given", None, "^given, cup$"),
    ],
)
def test_the_least_confident_thing_decides(things, label, confidence, said):
    found = verdict_on_selection(things)
    assert (found.label, found.confidence) == (label, confidence)
    assert re.search(said, str(found))
    assert found.candidates == ((2,) if things[-1] is UNSURE else ())


def test_a_candidate_that_somebody_chose_is_given_the_likeliest_too():
    asked = SelectedRegions(MASKS[None, :, 0], selected=(UNSURE,))
    assert asked.verdict.label == "question"
    chosen = replace(asked, chosen=True).verdict
    assert (chosen.label, chosen.confidence, chosen.candidates) == ("given", None, ())


@pytest.mark.parametrize(
    ("fits", "said"),
    [
        (True, "fox, confidence 98%"),
        (None, "what is marked ('fox' was not checked), confidence 98%"),
        (False, "what is marked ('fox' was found elsewhere), confidence 98%"),
    ],
)
def test_what_is_marked_has_the_name_only_where_that_fits(fits, said):
    how = ("marked", "geometry")
    marked = Selected(MASKS, how, confidence=0.98, called="fox", fits=fits)
    assert str(verdict_on_selection([marked])) == f"found, {said}"


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ("words", "question, fox, confidence 20%"),
        ("guess", "question, fox: what stands out most, confidence 20%"),
    ],
)
def test_a_click_beside_what_words_found_leaves_it_its_name(way, said):
    beside = Selected(MASKS, (way, "marked"), confidence=0.2, called="fox")
    assert str(verdict_on_selection([beside])).startswith(said)


def test_of_nothing_nothing_is_said():
    assert verdict_on_selection(()) is None


def test_what_nobody_marked_is_called_by_its_colour():
    red = Instruction("paint", Target("whole", part=Colour("red", (1, 0, 0))))
    by_colour = SelectedRegions(MASKS[None, :, 0], instructions=(red,))
    assert str(by_colour.verdict) == "given, what is red"
    handed_over = SelectedRegions(MASKS[None, :, 0])
    assert str(handed_over.verdict) == "given, what is marked"
