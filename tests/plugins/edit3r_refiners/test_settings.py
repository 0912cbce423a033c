import pytest
from edit3r_refiners.settings import parse_budget, passes


@pytest.mark.parametrize(
    ("given", "parsed"), [("auto", "auto"), ("all", "all"), ("500", 500), (7, 7)]
)
def test_a_budget_is_auto_all_or_a_number(given, parsed):
    assert parse_budget(given) == parsed


@pytest.mark.parametrize("given", ["many", 0, "-3", "1.5", True, None])
def test_another_budget_is_one_sentence(given):
    with pytest.raises(
        ValueError, match="expected auto, all or a number of at least 1"
    ):
        parse_budget(given)


@pytest.mark.parametrize(
    ("budget", "most", "steps"),
    [
        ("all", None, []),
        ("auto", None, [None]),
        (7, None, [7]),
        ("all", 9, [9]),
        ("auto", 9, [None, 9]),
        (7, 9, [7, 9]),
    ],
)
def test_a_limit_comes_on_top_of_the_budget(budget, most, steps):
    assert passes(budget, most) == steps
