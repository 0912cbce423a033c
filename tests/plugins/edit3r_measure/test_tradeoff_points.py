"""From measurements to figures, front, presets, table and plot."""

from itertools import pairwise

import numpy as np
import pytest
from edit3r_measure.tradeoff_knobs import SweepPlan
from edit3r_measure.tradeoff_points import (
    Spread,
    choose_presets,
    front,
    make_quality,
    on_every_front,
    summarize,
    with_distances,
)
from edit3r_measure.tradeoff_report import END, START, plot, report, write_into_page
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from edit3r.pipeline.quality import Expected, ShippedPoint, best_within

MEASURED = {
    "processor": "P",
    "cores": 2,
    "threads": 1,
    "versions": {"edit3r": "0"},
    "clock": "cpu",
    "command": "x",
}
FEW = st.integers(0, 6)  # few values, so that ties happen


@pytest.fixture
def measurement():
    """Makes one line of a sweep; times are of the runs that count, after a slow first one."""

    def make(
        label="base",
        scene="s0",
        kind="photos",
        seconds=(1.0, 2.0, 4.0),
        psnr=20.0,
        **others,
    ):
        warm_up = {
            "warm_up": True,
            "cpu": {"render": 99.0},
            "wall": {"render": 99.0},
            "load": 1.0,
        }
        runs = [
            {
                "warm_up": False,
                "cpu": {"edit (x)": 0.25 * s, "render": 0.75 * s},
                "wall": {"render": 2 * s},
                "load": 1.0,
            }
            for s in seconds
        ]
        return {
            "key": f"{label}-{scene}",
            "label": label,
            "settings": {"size": 8},
            "scene": scene,
            "kind": kind,
            "threads": 1,
            "measured_at": "2020-01-02T03:04:05Z",
            "runs": [warm_up, *runs],
            "memory_mb": 500.0,
            "start_memory_mb": 300.0,
            "gaussians": 100,
            "ply_bytes": 2_000_000,
            "repeatable": True,
            "psnr": psnr,
            "ssim": 0.5,
            "perceptual": None,
            "perceptual_by": None,
            "perceptual_missing": {"lpips": "install it"},
            **others,
        }

    return make


def test_time_is_the_middle_repeat_and_the_spread_is_kept(measurement):
    (point,) = summarize(
        [
            measurement(seconds=(1.0, 2.0, 4.0)),
            measurement(scene="s1", seconds=(3.0, 4.0, 8.0)),
        ]
    )
    figures = point.kinds["photos"]
    assert figures.cpu == Spread(
        2.0, 3.0, 6.0
    )  # means over the two scenes; the warm-up does not count
    assert figures.wall == Spread(4.0, 6.0, 12.0)
    assert figures.first == {"cpu": 99.0, "wall": 99.0}
    assert (
        figures.seconds("cpu") == 2.0
    )  # ranked by the repeats that were disturbed least
    assert figures.stages == {
        "edit": pytest.approx(0.75),
        "render": pytest.approx(2.25),
    }


def test_accuracy_is_the_mean_over_the_scenes_with_its_spread(measurement):
    (point,) = summarize([measurement(psnr=18.0), measurement(scene="s1", psnr=22.0)])
    assert point.kinds["photos"].psnr == 20.0
    assert point.kinds["photos"].psnr_of_scenes == Spread(18.0, 20.0, 22.0)


def test_a_point_that_failed_or_lacks_a_scene_is_left_out(measurement):
    rows = [measurement("a"), measurement("a", scene="s1"), measurement("b")]
    rows += [measurement("c"), {**measurement("c", scene="s1"), "failure": "no match"}]
    assert [p.label for p in summarize(rows)] == ["a"]


def test_uptake_is_known_where_the_truth_is(measurement):
    rows = [
        measurement(),
        measurement(scene="p", kind="procedural", uptake=0.9, leak=0.01),
    ]
    kinds = summarize(rows)[0].kinds
    assert kinds["photos"].uptake is None and kinds["procedural"].uptake == 0.9


def test_the_distance_is_to_the_novel_view_of_the_most_accurate_point(
    measurement, tmp_path
):
    rows = [measurement("low", psnr=10.0), measurement("high", psnr=20.0)]
    for row, value in zip(rows, (0, 51)):  # 0.2 apart: 10 log10(1 / 0.04) dB
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(
            tmp_path / f"{row['key']}.png"
        )
    low, high = with_distances(
        summarize(rows), rows, lambda key: tmp_path / f"{key}.png"
    )
    assert low.kinds["photos"].distance == pytest.approx(13.979, abs=1e-3)
    assert high.kinds["photos"].distance is None


def presets_of(rows, **plan):
    needed = {"unedited": {}, "edited": {}, "knobs": {}}
    points = summarize(rows)
    return points, make_quality(points, MEASURED, SweepPlan(**needed, **plan))


def test_presets_come_from_the_front_and_say_what_to_expect(measurement):
    times = {"a": 1.0, "b": 3.0, "c": 9.0, "slow": 10.0}
    accuracies = {"a": 18.0, "b": 19.0, "c": 20.0, "slow": 19.5}
    rows = [
        measurement(
            name,
            kind=kind,
            scene=kind,
            seconds=(t,),
            psnr=accuracies[name],
            settings={"size": 8, "fov": 50},
        )
        for name, t in times.items()
        for kind in ("photos", "procedural")
    ]
    _, quality = presets_of(rows, shipped=["size"], base={"fov": 50})
    assert [(p.label, p.preset, p.front) for p in quality.points] == [
        ("a", "fast", True),
        ("b", "balanced", True),
        ("c", "best", True),
        ("slow", None, False),
    ]
    assert quality.points[0].settings == {
        "size": 8
    }  # what is not a preset's business is not shipped
    assert quality.points[1].expected["photos"].seconds == 3.0
    assert [p.front for p in quality.points] == on_every_front(quality.points)


def test_a_point_that_changes_what_is_the_users_is_not_shipped(measurement):
    rows = [measurement("base"), measurement("three", settings={"size": 8, "views": 3})]
    _, quality = presets_of(rows, shipped=["size"])
    assert [point.label for point in quality.points] == ["base"]


def test_the_report_hides_neither_spread_nor_failure_nor_a_missing_distance(
    measurement,
):
    rows = [
        measurement(),
        {**measurement("odd"), "failure": "too dark"},
        measurement("other", repeatable=False),
    ]
    text = report(summarize(rows), rows, MEASURED, "cpu", {"base": "fast"})
    assert "2.00 (1.00 to 4.00)" in text and "| base | fast | yes |" in text
    assert "odd failed on s0: too dark" in text
    assert "other on s0: repeats did not leave the same scene." in text
    assert "No perceptual distance by lpips: install it" in text
    assert (
        "Ranked by processor time" in text
        and "wall time 2.00 times the processor time" in text
    )


def test_the_plot_names_the_presets(measurement, tmp_path):
    pytest.importorskip("matplotlib")
    rows = [
        measurement(name, kind=kind, scene=kind)
        for name in ("a", "b")
        for kind in ("photos", "procedural")
    ]
    plot(summarize(rows), "cpu", {"a": "fast"}, tmp_path / "plot.svg")
    text = (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert (
        "<!-- fast: a -->" in text
        and "<!-- b -->" in text
        and "<!-- procedural -->" in text
    )


def test_only_what_stands_between_the_markers_of_a_page_is_replaced(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{START}\nold\n{END}\nafter\n", encoding="utf-8")
    (tmp_path / "tradeoff.png").write_bytes(b"plot")
    write_into_page(page, "new\n", tmp_path / "tradeoff.png")
    text = page.read_text(encoding="utf-8")
    assert (
        text.startswith("before\n")
        and text.endswith("after\n")
        and "new" in text
        and "old" not in text
    )
    assert (
        "(images/page.png)" in text
        and (tmp_path / "images" / "page.png").read_bytes() == b"plot"
    )


def rated(name, seconds, accuracy, other=None):
    """A point with the same figures on two kinds of scene, or with `other` (seconds, accuracy) on
    the second.
    """
    names = ("seconds_first", "memory_mb", "start_memory_mb", "gaussians", "ssim")
    unused = dict.fromkeys(names, 1)
    first, second = (
        Expected(seconds=s, psnr=p, **unused)
        for s, p in ((seconds, accuracy), other or (seconds, accuracy))
    )
    return ShippedPoint(label=name, settings={}, expected={"a": first, "b": second})


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        ([], []),
        ([(1, 5)], [True]),
        (
            [(1, 5), (2, 6), (3, 6), (4, 7)],
            [True, True, False, True],
        ),  # slower and not better
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
    points = [
        rated("a", 1, 10),
        rated("b", 1.5, 11),
        rated("c", 3.5, 14),
        rated("d", 6, 15),
        rated("e", 8, 16),
    ]
    chosen = choose_presets(points, apart=2)
    assert {name: point.label for name, point in chosen.items()} == {
        "fast": "b",
        "balanced": "c",
        "best": "e",
    }


def test_a_preset_must_be_quick_enough_on_both_kinds():
    points = [rated("a", 1, 10), rated("b", 2, 12, other=(3, 12)), rated("c", 4, 14)]
    assert choose_presets(points, apart=2) == {}


def test_the_best_gives_way_when_nothing_lies_far_enough_below_it_otherwise():
    points = [rated("a", 1, 10), rated("b", 2, 11), rated("c", 4, 12)]
    assert [p.label for p in choose_presets(points, apart=2).values()] == [
        "a",
        "b",
        "c",
    ]
    assert choose_presets(points[:2], apart=2) == {}
    assert choose_presets([], apart=2) == {}


PAIRS = st.tuples(st.floats(0.1, 100), st.floats(0, 40))


@given(st.lists(st.tuples(PAIRS, PAIRS), max_size=10), st.floats(1.5, 3))
def test_presets_lie_on_both_fronts_and_apart(points, apart):
    points = [rated(str(i), *one, other=two) for i, (one, two) in enumerate(points)]
    chosen = list(choose_presets(points, apart).values())
    for kind in "ab":
        for point in chosen:
            beaten = [
                p
                for p in points
                if p.expected[kind].seconds < point.expected[kind].seconds
            ]
            assert all(
                p.expected[kind].psnr < point.expected[kind].psnr for p in beaten
            )
        for quick, slow in pairwise(chosen):
            assert apart * quick.expected[kind].seconds <= slow.expected[kind].seconds
            assert quick.expected[kind].psnr <= slow.expected[kind].psnr


def test_the_best_is_at_the_largest_size_of_photos_although_a_smaller_one_scores_higher():
    full, small = {"size": 512}, {"size": 256}
    points = [
        rated("a", 1, 10),
        rated("b", 2, 11),
        rated("c", 4, 12),
        rated("d", 5, 13),
    ]
    points = [
        p.model_copy(update={"settings": full if p.label == "c" else small})
        for p in points
    ]
    assert choose_presets(points, apart=2)["best"].label == "c"


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
