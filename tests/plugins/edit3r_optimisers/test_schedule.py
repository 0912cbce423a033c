"""Step sizes, harmonics and the order of views."""

import pytest
from edit3r_optimisers.schedule import active_degree, step_sizes, view_at
from edit3r_optimisers.settings import FitSettings


def test_centres_slow_down_log_linearly_in_units_of_the_scene():
    settings = FitSettings(means_rate=1e-2, means_rate_end=1e-4)
    sizes = [step_sizes(settings, step, 11, extent=3.0)["means"] for step in (0, 5, 10)]
    assert sizes == pytest.approx([3e-2, 3e-3, 3e-4])


def test_other_groups_keep_their_pace_and_harmonics_above_the_constant_move_at_a_twentieth():
    first, last = (step_sizes(FitSettings(), step, 100, 2.0) for step in (0, 99))
    assert {k: v for k, v in first.items() if k != "means"} == {k: v for k, v in last.items() if k != "means"}
    assert first["detail"] == pytest.approx(first["colour"] / 20)


def test_harmonics_come_in_one_degree_after_the_other():
    degrees = [active_degree(FitSettings(degree=2), step, 9) for step in range(9)]
    assert degrees == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_every_round_looks_at_every_view_once_in_its_own_order():
    rounds = [[view_at(7 * r + k, 7, seed=1) for k in range(7)] for r in range(4)]
    assert all(sorted(views) == list(range(7)) for views in rounds)
    assert len({tuple(views) for views in rounds}) > 1
