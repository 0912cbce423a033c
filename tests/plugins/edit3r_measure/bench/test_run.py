"""Killed at any moment and resumed, or spread over processes: the same report as the straight
run.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from edit3r_measure import bench_item
from edit3r_measure.bench_item import RESULTS, BenchRun, Method, read_results, run_bench
from edit3r_measure.bench_metrics import MetricSettings
from edit3r_measure.bench_report import read_columns, summary_of

from edit3r.errors import InputError
from edit3r.workers import Workers

ROOT = Path(__file__).parents[4]


@pytest.fixture
def run(manifest_file, cards, tmp_path):
    return make_run(manifest_file, cards, tmp_path / "out")


def make_run(manifest_file, cards, out, **settings):
    method = Method(label="cards", reconstructor={"name": "cards", **settings})
    return BenchRun(
        manifest_file,
        method,
        out,
        MetricSettings(effnet=False),
        edits=3,
        plugins=(cards,),
    )


@pytest.fixture(scope="module")
def straight(manifest_file, cards, tmp_path_factory):
    """The report of a run in one go."""
    out = tmp_path_factory.mktemp("straight") / "out"
    run_bench(make_run(manifest_file, cards, out))
    return summary_of(read_columns([out]))


def test_a_run_measures_every_edit_and_leaves_pictures(straight, run):
    seen = []
    results = run_bench(run, on_done=seen.append)
    assert [progress.done for progress in seen] == [1, 2, 3] and seen[
        -1
    ].seconds_left == 0
    for name, result in results.items():
        assert {
            "psnr",
            "ssim",
            "edit-uptake",
            "consistency-warped",
            "edit-strength",
        } <= set(result.metrics)
        files = {path.name for path in (run.out / "pictures" / name).iterdir()}
        assert files == {"photos.png", "edited.png", "shown.png", "truth.png"}
    assert summary_of(read_columns([run.out])) == straight
    assert [result.timing["cold"] for result in results.values()] == [
        True,
        False,
        False,
    ]


def test_a_finished_run_does_nothing_again(straight, run):
    run_bench(run)
    before = (run.out / RESULTS).read_bytes()
    run_bench(run, on_done=lambda progress: pytest.fail("measured again"))
    assert (run.out / RESULTS).read_bytes() == before


def test_two_processes_give_the_same_results(straight, run):
    run_bench(run, workers=Workers(2, threads=1))
    assert summary_of(read_columns([run.out])) == straight


def test_two_ray_workers_give_the_same_results(straight, run):
    pytest.importorskip("ray", reason="Ray is not installed (extra ray)")
    run_bench(run, workers=Workers(2, "ray", threads=1))
    assert summary_of(read_columns([run.out])) == straight


@pytest.mark.parametrize(
    ("stage", "items"), [("load_item", 1), ("measure", 3), ("save_strips", 2)]
)
def test_interrupted_inside_an_edit_and_resumed_gives_the_same_report(
    straight, run, monkeypatch, stage, items
):
    real, calls = getattr(bench_item, stage), []

    def stops(*arguments):
        calls.append(stage)
        if len(calls) == items:
            raise KeyboardInterrupt
        return real(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(bench_item, stage, stops)
        run_bench(run)
    assert len(read_results(run.out)) == items - 1
    run_bench(run)
    assert summary_of(read_columns([run.out])) == straight


def test_killed_and_resumed_gives_the_same_report(straight, run, cards):
    command = [
        "bench",
        "run",
        str(run.manifest_file),
        "--recon",
        "cards",
        "--plugin",
        cards,
        "--out",
        str(run.out),
    ]
    command += ["--set", "label=cards", "--no-effnet", "--edits", "3", "--quiet"]
    process = subprocess.Popen([sys.executable, "-m", "edit3r.cli.main", *command])
    try:
        wait_for(lambda: process.poll() is not None or lines(run.out) >= 2)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    run_bench(run)
    assert summary_of(read_columns([run.out])) == straight


def lines(out):
    path = out / RESULTS
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def wait_for(condition, seconds=300):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the run did not get that far"
        time.sleep(0.005)


def test_a_failure_is_a_result_with_its_sentence(manifest_file, cards, tmp_path):
    results = run_bench(make_run(manifest_file, cards, tmp_path / "out", fails=True))
    assert all(result.failure == "the cards fell over." for result in results.values())
    assert all(
        result.metrics["edit-uptake"] == 0 and result.metrics["psnr"] < 15
        for result in results.values()
    )


def test_a_folder_of_another_method_is_refused(manifest_file, cards, run):
    run_bench(run)
    with pytest.raises(InputError, match="another method"):
        run_bench(make_run(manifest_file, cards, run.out, depth=3.0))


def test_a_folder_with_other_files_is_refused(run):
    run.out.mkdir()
    (run.out / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not of a benchmark run"):
        run_bench(run)


def test_what_a_kill_left_half_written_is_no_obstacle(straight, run):
    run.out.mkdir()
    (run.out / ".bench-run.partial-0123.json").write_text('{"format": "edit3r-be')
    run_bench(run)
    assert summary_of(read_columns([run.out])) == straight


def test_the_run_says_what_it_is_of(straight, run, manifest):
    run_bench(run)
    run = json.loads((run.out / "bench-run.json").read_text())
    assert (
        run["manifest_sha256"] == manifest.sha256
        and run["method"]["reconstructor"]["name"] == "cards"
    )
    assert "torch" in run["versions"]


def test_the_manifest_makes_the_same_report_in_another_place_and_process(
    straight, run, cards, tmp_path
):
    """Another folder, another interpreter without this one's environment, the project imported from
    another path.
    """
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "code").mkdir(parents=True)
    for name in ("edit3r", "plugins"):
        (elsewhere / "code" / name).symlink_to(
            ROOT / name
        )  # links, so that kept kernels of numba are found
    shutil.copy(run.manifest_file, elsewhere / "copied.json")
    shutil.copy(cards, elsewhere / "plugin.py")
    kept = {
        name: os.environ[name]
        for name in ("PATH", "HOME", "VIRTUAL_ENV")
        if name in os.environ
    }
    paths = os.pathsep.join(
        [str(elsewhere / "code"), str(elsewhere / "code" / "plugins")]
    )
    command = [
        "bench",
        "run",
        "copied.json",
        "--recon",
        "cards",
        "--plugin",
        "plugin.py",
        "--out",
        "out",
        "--no-effnet",
    ]
    command += ["--edits", "3", "--set", "label=cards", "--quiet"]
    script = "import edit3r, sys; from edit3r.cli.main import main; print(edit3r.__file__); sys.exit(main(sys.argv[1:]))"
    process = subprocess.run(
        [sys.executable, "-c", script, *command],
        cwd=elsewhere,
        env={**kept, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert str(elsewhere) in process.stdout  # not the code that this test runs on
    assert summary_of(read_columns([elsewhere / "out"])) == straight
