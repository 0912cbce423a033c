"""Each figure that is bad makes the edit doubtful, and is said."""

from dataclasses import replace

import pytest
from edit3r_judge.edit_verdict import EditMeasures, judge_edit

GOOD = EditMeasures(
    shares=(0.1, 0.12),
    changed=0.9,
    outline=0.95,
    ghost=0.1,
    reached=0.9,
    agreement=0.9,
    shown=0.95,
)


def test_an_edit_without_a_bad_figure_is_good():
    verdict = judge_edit(GOOD)
    assert verdict.label == "good"
    assert "90% of what was selected changed visibly" in str(verdict)
    assert "the 3D scene shows it" in str(verdict)


@pytest.mark.parametrize(
    ("figure", "value", "sentence"),
    [
        ("shares", (0.0, 1e-4), "next to nothing was selected"),
        ("shares", (0.2, 0.01), "next to nothing was selected in photo 2"),
        ("clicked", 0.5, "50% of a photo was taken for the thing"),
        ("pieces", 0.4, "lies in several pieces"),
        ("part", 0.8, "has other colours and may be all that is meant"),
        ("taken", 0.4, "only 40% of what was selected took the colour"),
        ("made_up", 0.3, "is made up"),
        ("changed", 0.01, "only 1% of what was selected changed"),
        ("outline", 0.3, "leaves the edges"),
        ("ghost", 0.8, "outline of what was removed"),
        ("reached", 0.1, "90% of what changed does not look as asked"),
        ("agreement", 0.2, "differs between the photos"),
        ("shown", -0.2, "only 0% of the change arrived"),
        ("missed", 0.1, "a patch of 10% of what was changed is as it was"),
    ],
)
def test_one_bad_figure_is_enough_and_is_said(figure, value, sentence):
    verdict = judge_edit(replace(GOOD, **{figure: value}))
    assert verdict.label == "doubtful"
    assert sentence in verdict.reason


def test_a_guess_is_doubtful():
    assert "guessed" in judge_edit(GOOD, confidence=0.0).reason
    assert "30% confidence" in judge_edit(GOOD, confidence=0.3).reason
    assert judge_edit(GOOD, confidence=0.9).label == "good"


def test_figures_that_are_not_known_say_nothing():
    assert judge_edit(EditMeasures((0.1,), 0.9)).label == "good"
