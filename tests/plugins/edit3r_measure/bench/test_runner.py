"""Killed at any moment and resumed, or spread over processes: the same report as the straight run."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from edit3r_measure.bench import one_item
from edit3r_measure.bench.method import InstrumentSettings, Method
from edit3r_measure.bench.report import summary_of
from edit3r_measure.bench.results import RESULTS, ItemResult, append_result, read_results, repair
from edit3r_measure.bench.runner import Job, run_job
from edit3r_measure.bench.summary import read_columns

from edit3r.errors import InputError


@pytest.fixture
def job(manifest_file, cards, tmp_path):
    return make_job(manifest_file, cards, tmp_path / "out")


def make_job(manifest_file, cards, out, **settings):
    method = Method(label="cards", reconstructor={"name": "cards", **settings})
    return Job(manifest_file, method, out, InstrumentSettings(effnet=False), edits=3, plugins=(cards,))


@pytest.fixture(scope="module")
def straight(manifest_file, cards, tmp_path_factory):
    """The report of a run in one go."""
    out = tmp_path_factory.mktemp("straight") / "out"
    run_job(make_job(manifest_file, cards, out))
    return summary_of(read_columns([out]))


def test_a_run_measures_every_edit_and_leaves_pictures(straight, job):
    seen = []
    results = run_job(job, on_item=seen.append)
    assert [progress.done for progress in seen] == [1, 2, 3] and seen[-1].seconds_left == 0
    for name, result in results.items():
        assert {"psnr", "ssim", "edit-uptake", "consistency-warped", "edit-strength"} <= set(result.metrics)
        files = {path.name for path in (job.out / "pictures" / name).iterdir()}
        assert files == {"photos.png", "edited.png", "shown.png", "truth.png"}
    assert summary_of(read_columns([job.out])) == straight
    assert [result.timing["cold"] for result in results.values()] == [True, False, False]


def test_a_finished_run_does_nothing_again(straight, job):
    run_job(job)
    before = (job.out / RESULTS).read_bytes()
    run_job(job, on_item=lambda progress: pytest.fail("measured again"))
    assert (job.out / RESULTS).read_bytes() == before


def test_two_processes_give_the_same_results(straight, job):
    run_job(job, workers=2)
    assert summary_of(read_columns([job.out])) == straight


def test_two_ray_workers_give_the_same_results(straight, job):
    pytest.importorskip("ray", reason="Ray is not installed (extra ray)")
    run_job(job, workers=2, spread="ray")
    assert summary_of(read_columns([job.out])) == straight


@pytest.mark.parametrize(("stage", "items"), [("load_item", 1), ("measure", 3), ("save_pictures", 2)])
def test_interrupted_inside_an_edit_and_resumed_gives_the_same_report(straight, job, monkeypatch, stage, items):
    real, calls = getattr(one_item, stage), []

    def stops(*arguments):
        calls.append(stage)
        if len(calls) == items:
            raise KeyboardInterrupt
        return real(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(one_item, stage, stops)
        run_job(job)
    assert len(read_results(job.out)) == items - 1
    run_job(job)
    assert summary_of(read_columns([job.out])) == straight


def test_killed_and_resumed_gives_the_same_report(straight, job, cards):
    command = ["bench", "run", str(job.manifest), "--recon", "cards", "--plugin", cards, "--out", str(job.out)]
    command += ["--set", "label=cards", "--no-effnet", "--edits", "3", "--quiet"]
    process = subprocess.Popen([sys.executable, "-m", "edit3r.cli.main", *command])
    try:
        wait_for(lambda: process.poll() is not None or lines(job.out) >= 2)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    run_job(job)
    assert summary_of(read_columns([job.out])) == straight


def lines(out):
    path = out / RESULTS
    return path.read_bytes().count(b"\n") if path.is_file() else 0


def wait_for(condition, seconds=300):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the run did not get that far"
        time.sleep(0.005)


def test_a_line_cut_at_any_byte_is_measured_anew(tmp_path):
    whole = ItemResult("a", "s", "Add", {"psnr": 20.0, "ssim": float("nan")})
    append_result(tmp_path, whole)
    size = os.path.getsize(tmp_path / RESULTS)
    append_result(tmp_path, ItemResult("b", "s", "Add", {"psnr": 21.0}))
    content = (tmp_path / RESULTS).read_bytes()
    for end in range(size, len(content)):
        (tmp_path / RESULTS).write_bytes(content[:end])
        repair(tmp_path)
        assert set(read_results(tmp_path)) == {"a"}
        assert (tmp_path / RESULTS).read_bytes() == content[:size]


def test_a_failure_is_a_result_with_its_sentence(manifest_file, cards, tmp_path):
    results = run_job(make_job(manifest_file, cards, tmp_path / "out", fails=True))
    assert all(result.failure == "the cards fell over." for result in results.values())
    assert all(result.metrics["edit-uptake"] == 0 and result.metrics["psnr"] < 15 for result in results.values())


def test_a_folder_of_another_method_is_refused(manifest_file, cards, job):
    run_job(job)
    with pytest.raises(InputError, match="another method"):
        run_job(make_job(manifest_file, cards, job.out, depth=3.0))


def test_a_folder_with_other_files_is_refused(job):
    job.out.mkdir()
    (job.out / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not of a benchmark run"):
        run_job(job)


def test_what_a_kill_left_half_written_is_no_obstacle(straight, job):
    job.out.mkdir()
    (job.out / ".bench-run.partial-0123.json").write_text('{"format": "edit3r-be')
    run_job(job)
    assert summary_of(read_columns([job.out])) == straight


def test_the_run_says_what_it_is_of(straight, job, manifest):
    run_job(job)
    run = json.loads((job.out / "bench-run.json").read_text())
    assert run["manifest_sha256"] == manifest.sha256 and run["method"]["reconstructor"]["name"] == "cards"
    assert "torch" in run["versions"]
