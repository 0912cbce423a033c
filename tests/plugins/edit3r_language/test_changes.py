"""How much of a change words and percentages ask for."""

import pytest
from edit3r_language.changes import scaled

from edit3r.contract.instructions import Change


@pytest.mark.parametrize(
    ("kind", "times", "amount"),
    [("tint", 3, 1), ("tint", 0.5, 0.2), ("brightness", 3, 1.2)],
)
def test_a_tint_goes_all_the_way_at_most_and_other_changes_further(kind, times, amount):
    assert scaled(Change(kind, amount=0.4), times).amount == pytest.approx(amount)
