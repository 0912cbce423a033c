"""The report compares like with like, and says what failed."""

import json

import pytest
from edit3r_measure.bench_item import BenchRun, Method, run_bench
from edit3r_measure.bench_metrics import MetricSettings
from edit3r_measure.bench_report import mean_of, read_columns, write_page, write_report

from edit3r.errors import InputError


@pytest.fixture(scope="module")
def runs(manifest_file, cards, tmp_path_factory):
    """Three methods: flat cards, the same with nothing done, and one that fails."""
    out = tmp_path_factory.mktemp("runs")
    methods = [
        Method(label="cards", reconstructor={"name": "cards"}),
        Method(
            label="nothing done",
            editor={"name": "none"},
            reconstructor={"name": "cards"},
            truth=True,
        ),
        Method(label="fails", reconstructor={"name": "cards", "fails": True}),
    ]
    for position, method in enumerate(methods):
        folder = out / method.label
        metrics = MetricSettings(effnet=False)
        run_bench(
            BenchRun(
                manifest_file,
                method,
                folder,
                metrics,
                edits=2,
                plugins=(cards,),
                position=position,
            )
        )
    return out


def test_methods_are_columns_in_the_order_they_were_given(runs):
    assert [column.label for column in read_columns([runs])] == [
        "cards",
        "nothing done",
        "fails",
    ]


def test_doing_nothing_cannot_win_and_failing_is_counted(runs):
    cards, nothing, fails = read_columns([runs])
    assert mean_of(cards, "score").mean > 3 * abs(mean_of(nothing, "score").mean)
    assert mean_of(fails, "score").mean == 0 and len(fails.failures) == 2
    assert mean_of(fails, "psnr").mean < mean_of(cards, "psnr").mean


def test_a_difference_is_edit_by_edit(runs):
    cards, nothing, _ = read_columns([runs])
    expected = mean_of(cards, "psnr").mean - mean_of(nothing, "psnr").mean
    assert mean_of(cards, "psnr", minus=nothing).mean == pytest.approx(expected)
    assert mean_of(cards, "psnr", minus=cards).mean == 0


def test_only_edits_that_all_methods_tried_are_compared(
    runs, manifest_file, cards, tmp_path
):
    method = Method(label="one", reconstructor={"name": "cards"})
    run_bench(
        BenchRun(
            manifest_file,
            method,
            tmp_path / "one",
            MetricSettings(effnet=False),
            edits=1,
            plugins=(cards,),
        )
    )
    columns = read_columns([runs, tmp_path / "one"])
    assert all(len(column.results) == 1 for column in columns)


def test_the_report_is_tables_numbers_and_one_page(runs, tmp_path):
    columns = read_columns([runs])
    write_report(columns, tmp_path / "report")
    text = (tmp_path / "report" / "report.md").read_text()
    assert (
        "|  | cards | nothing done | fails |" in text and "the cards fell over" in text
    )
    content = json.loads((tmp_path / "report" / "report.json").read_text())
    assert (
        content["methods"]["cards"]["metrics"]["psnr"]["mean"]
        == mean_of(columns[0], "psnr").mean
    )
    assert (
        content["timing"]["cards"]["warm_edits"] == 1
        and content["timing"]["fails"]["warm"] is None
    )
    page = (tmp_path / "report" / "index.html").read_text()
    assert (
        page.count("data:image/webp") >= 2 * 6
        and "failed: the cards fell over." in page
    )
    assert "http://" not in page.replace("http://www.w3.org", "").replace(
        "http://purl.org", ""
    ).replace("http://creativecommons.org", "")


def test_the_same_results_give_the_same_report(runs, tmp_path):
    for name in ("a", "b"):
        write_report(read_columns([runs]), tmp_path / name)
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_runs_of_different_benchmarks_are_not_compared(runs, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    run = json.loads((runs / "cards" / "bench-run.json").read_text())
    (other / "bench-run.json").write_text(json.dumps({**run, "manifest_sha256": "0"}))
    with pytest.raises(InputError, match="another benchmark"):
        read_columns([runs, other])


def test_a_folder_without_results_is_one_sentence(tmp_path):
    with pytest.raises(InputError, match="it has no bench-run"):
        read_columns([tmp_path])


def test_the_page_shows_the_reports_markdown(tmp_path):
    text = "# A & B\n\n- one\n- **two** <i>\n\n| a | b |\n| --- | --: |\n| `x` | 1 |\n\nplain"
    write_page(tmp_path / "index.html", text, [], 20)
    shown = (tmp_path / "index.html").read_text()
    assert (
        "<h1>A &amp; B</h1>" in shown
        and "<li><strong>two</strong> &lt;i&gt;</li>" in shown
    )
    assert (
        "<th>a</th>" in shown
        and "<td><code>x</code></td>" in shown
        and "<p>plain</p>" in shown
    )
