import numpy as np
import pytest
from edit3r_measure.tradeoff.distance import with_distances
from edit3r_measure.tradeoff.figures import Spread, summarize
from edit3r_measure.tradeoff.front import on_every_front
from edit3r_measure.tradeoff.knobs import SweepPlan
from edit3r_measure.tradeoff.plot import plot
from edit3r_measure.tradeoff.report import END, START, report, write_into_page
from edit3r_measure.tradeoff.shipping import make_quality
from PIL import Image

MEASURED = {"processor": "P", "cores": 2, "threads": 1, "versions": {"edit3r": "0"}, "clock": "cpu", "command": "x"}


def test_time_is_the_middle_repeat_and_the_spread_is_kept(measurement):
    (point,) = summarize([measurement(seconds=(1.0, 2.0, 4.0)), measurement(scene="s1", seconds=(3.0, 4.0, 8.0))])
    figures = point.kinds["photos"]
    assert figures.cpu == Spread(2.0, 3.0, 6.0)  # means over the two scenes; the warm-up does not count
    assert figures.wall == Spread(4.0, 6.0, 12.0)
    assert figures.first == {"cpu": 99.0, "wall": 99.0}
    assert figures.seconds("cpu") == 2.0  # ranked by the repeats that were disturbed least
    assert figures.stages == {"edit": pytest.approx(0.75), "render": pytest.approx(2.25)}


def test_accuracy_is_the_mean_over_the_scenes_with_its_spread(measurement):
    (point,) = summarize([measurement(psnr=18.0), measurement(scene="s1", psnr=22.0)])
    assert point.kinds["photos"].psnr == 20.0
    assert point.kinds["photos"].psnr_of_scenes == Spread(18.0, 20.0, 22.0)


def test_a_point_that_failed_or_lacks_a_scene_is_left_out(measurement):
    rows = [measurement("a"), measurement("a", scene="s1"), measurement("b")]
    rows += [measurement("c"), {**measurement("c", scene="s1"), "failure": "no match"}]
    assert [p.label for p in summarize(rows)] == ["a"]


def test_uptake_is_known_where_the_truth_is(measurement):
    rows = [measurement(), measurement(scene="p", kind="procedural", uptake=0.9, leak=0.01)]
    kinds = summarize(rows)[0].kinds
    assert kinds["photos"].uptake is None and kinds["procedural"].uptake == 0.9


def test_the_distance_is_to_the_novel_view_of_the_most_accurate_point(measurement, tmp_path):
    rows = [measurement("low", psnr=10.0), measurement("high", psnr=20.0)]
    for row, value in zip(rows, (0, 51)):  # 0.2 apart: 10 log10(1 / 0.04) dB
        Image.fromarray(np.full((8, 8, 3), value, np.uint8)).save(tmp_path / f"{row['key']}.png")
    low, high = with_distances(summarize(rows), rows, lambda key: tmp_path / f"{key}.png")
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
        measurement(name, kind=kind, scene=kind, seconds=(t,), psnr=accuracies[name], settings={"size": 8, "fov": 50})
        for name, t in times.items()
        for kind in ("photos", "procedural")
    ]
    points, quality = presets_of(rows, shipped=["size"], base={"fov": 50})
    assert [(p.label, p.preset, p.front) for p in quality.points] == [
        ("a", "fast", True),
        ("b", "balanced", True),
        ("c", "best", True),
        ("slow", None, False),
    ]
    assert quality.points[0].settings == {"size": 8}  # what is not a preset's business is not shipped
    assert quality.points[1].expected["photos"].seconds == 3.0
    assert [p.front for p in quality.points] == on_every_front([p.rated("cpu") for p in points])


def test_a_point_that_changes_what_is_the_users_is_not_shipped(measurement):
    rows = [measurement("base"), measurement("three", settings={"size": 8, "views": 3})]
    _, quality = presets_of(rows, shipped=["size"])
    assert [point.label for point in quality.points] == ["base"]


def test_the_report_hides_neither_spread_nor_failure_nor_a_missing_distance(measurement):
    rows = [measurement(), {**measurement("odd"), "failure": "too dark"}, measurement("other", repeatable=False)]
    text = report(summarize(rows), rows, MEASURED, "cpu", {"base": "fast"})
    assert "2.00 (1.00 to 4.00)" in text and "| base | fast | yes |" in text
    assert "odd failed on s0: too dark" in text
    assert "other on s0: repeats did not leave the same scene." in text
    assert "No perceptual distance by lpips: install it" in text
    assert "Ranked by processor time" in text and "wall time 2.00 times the processor time" in text


def test_the_plot_names_the_presets(measurement, tmp_path):
    pytest.importorskip("matplotlib")
    rows = [measurement(name, kind=kind, scene=kind) for name in ("a", "b") for kind in ("photos", "procedural")]
    plot(summarize(rows), "cpu", {"a": "fast"}, tmp_path / "plot.svg")
    text = (tmp_path / "plot.svg").read_text(encoding="utf-8")
    assert "<!-- fast: a -->" in text and "<!-- b -->" in text and "<!-- procedural -->" in text


def test_only_what_stands_between_the_markers_of_a_page_is_replaced(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{START}\nold\n{END}\nafter\n", encoding="utf-8")
    write_into_page(page, "new\n", "images/x.png")
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n") and text.endswith("after\n") and "new" in text and "old" not in text
    assert "(images/x.png)" in text
