"""The score cannot be won by doing nothing, nor by any single virtue."""

import math

import pytest
from edit3r_bench.measures import FULL_STRENGTH, score

GOOD = {
    "edit-uptake-2d": 0.9,
    "edit-strength-2d": 0.1,
    "change-outside": 0.02,
    "consistency-warped": 0.02,
    "consistency-held-back": 0.02,
}
PERFECT = {"change_outside": 0, "consistency_warped": 0, "consistency_held_back": 0}


def score_with(failure="", **changes):
    """The score of a good edit with other values of some metrics."""
    named = {name.replace("_", "-"): value for name, value in changes.items()}
    return score(GOOD | named, failure)


def test_the_score_of_a_hand_made_edit():
    # 0.9 arrived; 1 - 0.02 / 0.1 = 0.8 agrees; the same stays put
    assert score_with() == pytest.approx(0.9 * 0.8)


def test_doing_nothing_perfectly_scores_nothing():
    assert score_with(edit_uptake_2d=0.0, edit_strength_2d=0.0, **PERFECT) == 0
    assert score_with(edit_uptake=0.0, **PERFECT) == 0


def test_next_to_nothing_loses_to_an_honest_edit():
    timid = {"edit_uptake_2d": 1, "edit_strength_2d": FULL_STRENGTH / 20}
    assert score_with(**timid, **PERFECT) < 0.1 < score_with()


def test_the_truth_counts_where_it_is_known():
    assert score_with(edit_uptake=0.3) == pytest.approx(0.3 * 0.8)
    assert score_with(edit_uptake=-0.5) == 0


def test_views_that_do_not_agree_or_a_spoiled_surrounding_cost_everything():
    assert score_with(consistency_warped=0.2, consistency_held_back=0.2) == 0
    assert score_with(change_outside=0.3) == 0


def test_a_global_edit_has_no_outside_to_spoil():
    assert score_with(change_outside=math.nan) == pytest.approx(0.9 * math.sqrt(0.8))


def test_a_failure_scores_nothing():
    assert score_with("no matches") == 0
