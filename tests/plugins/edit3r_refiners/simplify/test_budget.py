import pytest
from edit3r_refiners.simplify.budget import parse_budget, passes

from edit3r.errors import SettingsError
from edit3r.run_config import make_run_config


@pytest.mark.parametrize(("given", "parsed"), [("auto", "auto"), ("all", "all"), ("500", 500), (7, 7)])
def test_a_budget_is_auto_all_or_a_number(given, parsed):
    assert parse_budget(given) == parsed
    assert make_run_config({"gaussians": given}).gaussians == parsed


@pytest.mark.parametrize("given", ["many", 0, "-3", "1.5", True, None])
def test_another_budget_is_one_sentence(given):
    with pytest.raises(SettingsError, match=r"run\.gaussians: expected auto, all or a number of at least 1, got"):
        make_run_config({"gaussians": given})


@pytest.mark.parametrize(
    ("wish", "most", "steps"),
    [
        ("all", None, []),
        ("auto", None, [None]),
        (7, None, [7]),
        ("all", 9, [9]),
        ("auto", 9, [None, 9]),
        (7, 9, [7, 9]),
    ],
)
def test_a_limit_comes_on_top_of_the_wish(wish, most, steps):
    assert passes(wish, most) == steps
