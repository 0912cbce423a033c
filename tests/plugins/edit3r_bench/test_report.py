"""The report compares like with like, and says what failed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from edit3r_bench.method import Method
from edit3r_bench.options import RunOptions
from edit3r_bench.page import write_page
from edit3r_bench.report import (
    Column,
    main_table,
    mean_of,
    read_columns,
    report_text,
    write_report,
)
from edit3r_bench.run import BenchRun, ItemResult, read_results, run_bench

from edit3r.contract.errors import InputError

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def bench(manifest_file, cards):
    """Does some edits by flat cards, in a folder of the label's name."""

    def run(out, label, edits=2, position=0, fails=False, **method):
        cards_that = {"name": "cards", "fails": fails}
        chosen = Method(label=label, reconstructor=cards_that, **method)
        options = RunOptions(no_effnet=True, edits=edits)
        one = BenchRun(manifest_file, chosen, out / label, options, (cards,))
        run_bench(replace(one, position=position))

    return run


@pytest.fixture(scope="module")
def runs(bench, tmp_path_factory):
    """Three methods: flat cards, the same with nothing done, and one that fails."""
    out = tmp_path_factory.mktemp("runs")
    bench(out, "cards")
    bench(out, "nothing done", position=1, editor="none", truth=True)
    bench(out, "fails", position=2, fails=True)
    return out


def test_methods_are_columns_in_the_order_they_were_given(runs):
    labels = [column.label for column in read_columns([runs])]
    assert labels == ["cards", "nothing done", "fails"]


def test_doing_nothing_cannot_win_and_failing_is_counted(runs):
    cards, nothing, fails = read_columns([runs])
    assert mean_of(cards, "score").mean > 3 * abs(mean_of(nothing, "score").mean)
    assert mean_of(fails, "score").mean == 0
    assert len(fails.failures) == 2
    assert mean_of(fails, "psnr").mean < mean_of(cards, "psnr").mean


def test_a_difference_is_edit_by_edit(runs):
    cards, nothing, _ = read_columns([runs])
    expected = mean_of(cards, "psnr").mean - mean_of(nothing, "psnr").mean
    assert mean_of(cards, "psnr", minus=nothing).mean == pytest.approx(expected)
    assert mean_of(cards, "psnr", minus=cards).mean == 0


def test_only_edits_that_all_methods_tried_are_compared(runs, bench, tmp_path):
    bench(tmp_path, "one", edits=1)
    columns = read_columns([runs, tmp_path / "one"])
    assert all(len(column.results) == 1 for column in columns)


def test_the_report_is_tables_numbers_and_one_page(runs, tmp_path):
    columns = read_columns([runs])
    write_report(columns, tmp_path / "a")
    text = (tmp_path / "a" / "report.md").read_text()
    assert "|  | scenes | cards | nothing done | fails |" in text
    assert "the cards fell over" in text
    content = json.loads((tmp_path / "a" / "report.json").read_text())
    psnr = content["methods"]["cards"]["metrics"]["psnr"]
    assert psnr["mean"] == mean_of(columns[0], "psnr").mean
    assert content["timing"]["cards"]["warm_edits"] == 1
    assert content["timing"]["fails"]["warm"] is None
    page = (tmp_path / "a" / "index.html").read_text()
    assert page.count("data:image/webp") == 2 * 2
    assert "http://" not in page
    write_report(read_columns([runs]), tmp_path / "b")
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_runs_of_another_benchmark_or_version_are_not_compared(runs, tmp_path):
    run = json.loads((runs / "cards" / "bench-run.json").read_text())
    for key, words in (("manifest_sha256", "another benchmark"), ("version", "again")):
        file = tmp_path / "bench-run.json"
        file.write_text(json.dumps({**run, key: "0"}))
        with pytest.raises(InputError, match=words):
            read_columns([runs, tmp_path])


def test_a_folder_without_results_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="it has no bench-run"):
        read_columns([tmp_path])


ROW = {"id": "a", "scene": "s", "type": "recolour", "failure": "out of memory"}
ROW |= {"metrics": {"psnr": None}}


@pytest.mark.parametrize(
    "wrong", [{"metrics": 5}, {"metrics": {"psnr": "high"}}, {"more": 1}, {"scene": 5}]
)
def test_a_line_that_is_no_result_is_named(tmp_path, wrong):
    lines = [ROW, {**ROW, "id": "b", **wrong}]
    if "more" in wrong:
        del lines[1]["scene"]
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (tmp_path / "results.jsonl").write_text(text)
    with pytest.raises(InputError, match=r"results\.jsonl, line 2: not a result"):
        read_results(tmp_path)


def test_the_page_shows_the_reports_markdown(tmp_path):
    text = "# A & B\n\n- one\n- **two** <i>\n\n| a | b |\n| --- | --: |\n| `x` | 1 |\n"
    write_page(tmp_path / "index.html", text, {}, [])
    shown = (tmp_path / "index.html").read_text()
    assert "<h1>A &amp; B</h1>" in shown
    assert "<li><strong>two</strong> &lt;i&gt;</li>" in shown
    assert "<td><code>x</code></td>" in shown


# ---- how sure it is ----


def column(label, scenes, psnr, outside, missing=0):
    """A method with one edit a scene; draws of `psnr` and `change-outside` about these means."""
    rng = np.random.default_rng(scenes)
    results = {}
    for index in range(scenes):
        metrics = {"psnr": psnr + rng.normal()}
        metrics["change-outside"] = outside + 0.1 * rng.normal()
        if index < missing:
            del metrics["change-outside"]
        name = f"s{index}-edit"
        results[name] = ItemResult(name, f"s{index}", "Modify", metrics)
    method = Method(label=label).model_dump(mode="json")
    run = {"method": method, "manifest": "m", "manifest_sha256": "0"}
    return Column(label, run, results)


def test_every_row_says_of_how_many_scenes_and_few_have_no_interval():
    few = [column("a", 4, 20, 0.5), column("b", 4, 18, 0.5, missing=1)]
    table = main_table(few)
    assert "| psnr ↑ | 4 | 19.69 | 17.69 |" in table
    assert "| change-outside ↓ | 3 to 4 |" in table
    assert "(" not in table
    assert "| psnr ↑ | 5 | 20." in main_table([column("a", 5, 20, 0.5)])
    assert "(" in main_table([column("a", 5, 20, 0.5)])


def test_a_difference_is_called_better_only_where_it_outlasts_the_correction():
    first = column("a", 10, 20, 0.5)
    better = column("b", 10, 18, 0.2)
    better.results["s0-edit"].metrics["psnr"] += 0.5
    better.results["s0-edit"].metrics["change-outside"] += 0.01
    text = report_text([first, better])
    assert "| a - b |" in text
    assert " better |" in next(x for x in text.splitlines() if "+1.9" in x)
    assert " worse |" in next(x for x in text.splitlines() if "+0.29" in x)
    # One in 20 comparisons of equals looks different; corrected, none of 40 does.
    rng = np.random.default_rng(0)
    equals = []
    for index in range(40):
        other = column(f"m{index}", 10, 20, 0.5)
        for result in other.results.values():
            result.metrics["psnr"] += rng.normal()
            del result.metrics["change-outside"]
        equals.append(other)
    p_values = [mean_of(first, "psnr", minus=other).p_value for other in equals]
    assert min(p_values) < 0.05
    text = report_text([first, *equals])
    assert " better |" not in text
    assert " worse |" not in text
