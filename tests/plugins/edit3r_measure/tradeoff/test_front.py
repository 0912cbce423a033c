from itertools import pairwise

import pytest
from edit3r_measure.tradeoff.front import Rated, best_within, choose_presets, front, on_every_front
from hypothesis import given
from hypothesis import strategies as st

FEW = st.integers(0, 6)  # few values, so that ties happen


def rated(name, seconds, accuracy, other=None):
    """A point with the same figures on two kinds of scene, or with `other` (seconds, accuracy) on the second."""
    second = other or (seconds, accuracy)
    return Rated(name, {"a": seconds, "b": second[0]}, {"a": accuracy, "b": second[1]})


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([], []),
        ([(1, 5)], [True]),
        ([(1, 5), (2, 6), (3, 6), (4, 7)], [True, True, False, True]),  # slower and not better
        ([(1, 5), (1, 6)], [False, True]),  # as quick and worse
        ([(2, 5), (2, 5)], [True, True]),  # equal twins stay
        ([(3, 9), (1, 9)], [False, True]),
    ],
)
def test_the_front_is_what_a_hand_would_draw(points, expected):
    assert front([p[0] for p in points], [p[1] for p in points]) == expected


@given(st.lists(st.tuples(FEW, FEW), max_size=12))
def test_nothing_is_both_quicker_and_more_accurate_than_a_point_on_the_front(points):
    flags = front([p[0] for p in points], [p[1] for p in points])
    for (seconds, accuracy), flag in zip(points, flags):
        if flag:
            assert not any(s < seconds and a > accuracy for s, a in points)


@given(st.lists(st.tuples(FEW, FEW), min_size=1, max_size=12))
def test_every_point_off_the_front_has_a_better_one_on_it(points):
    flags = front([p[0] for p in points], [p[1] for p in points])
    on = [point for point, flag in zip(points, flags) if flag]
    for seconds, accuracy in points:
        assert any(s <= seconds and a >= accuracy for s, a in on)


def test_a_point_must_be_on_the_front_of_every_kind():
    points = [rated("x", 1, 5), rated("y", 2, 6, other=(2, 4))]
    assert on_every_front(points) == [True, False]


def test_presets_by_hand():
    points = [rated("a", 1, 10), rated("b", 1.5, 11), rated("c", 3.5, 14), rated("d", 6, 15), rated("e", 8, 16)]
    chosen = choose_presets(points, apart=2)
    assert {name: point.name for name, point in chosen.items()} == {"fast": "b", "balanced": "c", "best": "e"}


def test_a_preset_must_be_quick_enough_on_both_kinds():
    points = [rated("a", 1, 10), rated("b", 2, 12, other=(3, 12)), rated("c", 4, 14)]
    assert choose_presets(points, apart=2) == {}


def test_the_best_gives_way_when_nothing_lies_far_enough_below_it_otherwise():
    points = [rated("a", 1, 10), rated("b", 2, 11), rated("c", 4, 12)]
    assert [p.name for p in choose_presets(points, apart=2).values()] == ["a", "b", "c"]
    assert choose_presets(points[:2], apart=2) == {}
    assert choose_presets([], apart=2) == {}


PAIRS = st.tuples(st.floats(0.1, 100), st.floats(0, 40))


@given(st.lists(st.tuples(PAIRS, PAIRS), max_size=10), st.floats(1.5, 3))
def test_presets_lie_on_both_fronts_and_apart(points, apart):
    points = [rated(str(i), *one, other=two) for i, (one, two) in enumerate(points)]
    chosen = list(choose_presets(points, apart).values())
    for kind in "ab":
        for point in chosen:
            beaten = [p for p in points if p.costs[kind] < point.costs[kind]]
            assert all(p.accuracies[kind] < point.accuracies[kind] for p in beaten)
        for quick, slow in pairwise(chosen):
            assert apart * quick.costs[kind] <= slow.costs[kind]
            assert quick.accuracies[kind] <= slow.accuracies[kind]


def test_within_limits_the_most_accurate_is_taken():
    costs = [{"s": 1, "g": 10}, {"s": 2, "g": 5}, {"s": 3, "g": 30}]
    assert best_within(costs, [1, 2, 3], {}) == 2
    assert best_within(costs, [1, 2, 3], {"s": 2.5}) == 1
    assert best_within(costs, [1, 2, 3], {"s": 1.5, "g": 10}) == 0
    assert best_within(costs, [1, 2, 3], {"g": 4}) is None
    assert best_within(costs, [2, 2, 1], {}) == 0


@given(st.lists(st.tuples(FEW, FEW, FEW), max_size=10), FEW)
def test_what_is_taken_fits_and_nothing_better_does(points, most):
    costs = [{"s": s} for s, _, _ in points]
    accuracies = [a for _, a, _ in points]
    index = best_within(costs, accuracies, {"s": most})
    fitting = [a for (s, a, _) in points if s <= most]
    assert (index is None) == (not fitting)
    if index is not None:
        assert costs[index]["s"] <= most and accuracies[index] == max(fitting)
