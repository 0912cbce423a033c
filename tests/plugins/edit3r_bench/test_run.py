"""Interrupted and resumed, in another place and process: the same report as the straight run."""

import json
import os
import pickle
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from statistics import median

import pytest
from edit3r_bench import run as bench_run
from edit3r_bench.method import Method, read_methods
from edit3r_bench.options import RunOptions
from edit3r_bench.report import read_columns, summary_of, time_table
from edit3r_bench.run import (
    RESULTS,
    BenchRun,
    read_results,
    run_bench,
    timing_of,
)
from edit3r_model.network import GaussianNetwork

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, StageRecord
from edit3r.kit.command.results import alone_in
from edit3r.kit.files.configs import find_config, read_yaml
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.weights.files import WEIGHTS, save_weights
from edit3r.kit.workers import run_resumable

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]


@pytest.fixture
def run(manifest_file, cards, tmp_path):
    return make_run(manifest_file, cards, tmp_path / "out")


def make_run(manifest_file, cards, out, **settings):
    method = Method(label="cards", reconstructor={"name": "cards", **settings})
    options = RunOptions(no_effnet=True, edits=3)
    return BenchRun(manifest_file, method, out, options, (cards,))


def with_options(run, **options):
    return replace(run, options=run.options.model_copy(update=options))


def report_of(run):
    return summary_of(read_columns([run.out]))


@pytest.fixture(scope="module")
def straight(manifest_file, cards, tmp_path_factory):
    """The report of a run in one go."""
    run = make_run(manifest_file, cards, tmp_path_factory.mktemp("straight") / "out")
    run_bench(run)
    return report_of(run)


def test_a_run_measures_every_edit_leaves_sheets_and_does_nothing_again(straight, run):
    seen = []
    results = run_bench(run, seen.append)
    assert [progress.done for progress in seen] == [1, 2, 3]
    assert seen[-1].seconds_left == 0
    for name, result in results.items():
        assert {"psnr", "edit-uptake", "consistency-warped"} <= set(result.metrics)
        assert (run.out / "pictures" / f"{name}.webp").is_file()
    assert report_of(run) == straight
    cold = [result.timing["cold"] for result in results.values()]
    assert cold == [True, False, False]
    before = (run.out / RESULTS).read_bytes()
    run_bench(run, lambda progress: pytest.fail("measured again"))
    assert (run.out / RESULTS).read_bytes() == before


@pytest.mark.parametrize(("ray", "spread"), [(False, "processes"), (True, "ray")])
def test_workers_get_the_run_as_it_can_be_pickled(
    straight, run, monkeypatch, ray, spread
):
    """What workers do with it is proven in tests of the kit."""
    asked = []

    def elsewhere(jobs, function, path, *, workers, **more):
        asked.append(workers)
        copy = pickle.loads(pickle.dumps(function))
        return run_resumable(jobs, copy, path, **more)

    monkeypatch.setattr(bench_run, "run_resumable", elsewhere)
    run_bench(with_options(run, workers=2, ray=ray))
    assert [(one.count, one.spread) for one in asked] == [(2, spread)]
    assert report_of(run) == straight


@pytest.mark.parametrize(
    ("stage", "items"), [("load_item", 1), ("measure", 3), ("save_sheet", 2)]
)
def test_interrupted_inside_an_edit_and_resumed_gives_the_same_report(
    straight, run, monkeypatch, stage, items
):
    real = getattr(bench_run, stage)
    calls = []

    def stops(*arguments):
        calls.append(stage)
        if len(calls) == items:
            raise KeyboardInterrupt
        return real(*arguments)

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(bench_run, stage, stops)
        run_bench(run)
    assert len(read_results(run.out)) == items - 1
    run_bench(run)
    assert report_of(run) == straight


OPTIONS = "--recon cards --set label=cards --no-effnet --edits 3 --quiet"


def test_a_failure_is_a_result_with_its_sentence(manifest_file, cards, tmp_path):
    results = run_bench(make_run(manifest_file, cards, tmp_path / "out", fails=True))
    for result in results.values():
        assert result.failure == "the cards fell over."
        assert result.metrics["edit-uptake"] == 0
        assert result.metrics["psnr"] < 15


def test_a_folder_of_something_else_or_in_use_is_refused(manifest_file, cards, run):
    with alone_in(run.out), pytest.raises(InputError, match="another run writes"):
        run_bench(run)
    (run.out / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="do not belong to a benchmark run"):
        run_bench(run)
    (run.out / "thesis.tex").unlink()
    # What a kill left half written is no obstacle.
    (run.out / ".bench-run.partial-0123.json").write_text('{"format": "edit3r-be')
    run_bench(run)
    with pytest.raises(InputError, match="another method"):
        run_bench(make_run(manifest_file, cards, run.out, depth=3.0))


def test_the_run_says_what_it_is_of(run, manifest):
    run_bench(run)
    said = json.loads((run.out / "bench-run.json").read_text())
    assert said["manifest_sha256"] == manifest.sha256
    assert said["method"]["reconstructor"]["name"] == "cards"
    assert "torch" in said["versions"]


ELSEWHERE = """
import edit3r, sys
from edit3r.cli.main import main
print(edit3r.__file__)
sys.exit(main(sys.argv[1:]))
"""


def test_the_manifest_makes_the_same_report_in_another_place_and_process(
    straight, run, cards, tmp_path
):
    """Another folder, another interpreter without this one's environment, the project imported from
    another path.
    """
    elsewhere = tmp_path / "elsewhere"
    code = elsewhere / "code"
    code.mkdir(parents=True)
    for name in ("edit3r", "plugins"):
        # Links, so that kept kernels of numba are found.
        (code / name).symlink_to(ROOT / name)
    shutil.copy(run.manifest_file, elsewhere / "copied.json")
    shutil.copy(cards, elsewhere / "plugin.py")
    kept = {"PYTHONPATH": f"{code}{os.pathsep}{code}/plugins"}
    for name in ("PATH", "HOME", "VIRTUAL_ENV"):
        if name in os.environ:
            kept[name] = os.environ[name]
    command = f"bench run copied.json --plugin plugin.py --out out {OPTIONS}"
    process = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, *command.split()],
        cwd=elsewhere,
        env=kept,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert str(elsewhere) in process.stdout  # not the code that this test runs on
    assert summary_of(read_columns([elsewhere / "out"])) == straight


# ---- time ----


def test_time_counts_all_that_a_run_does_between_photos_and_scene():
    before = ("start", "read photos", "load components")
    between = ("select", "reconstruct (x)", "keep-outside-mask", "simplify", "refine")
    after = ("check", "write files")
    stages = [StageRecord(name, 100, 100, 0) for name in (*before, *after)]
    stages += [StageRecord(name, 1, 10, 0) for name in between]
    stages += [StageRecord("edit (x)", 2, 20, 0), StageRecord("render", 3, 30, 0)]
    timing = timing_of(stages, cold=True, views=2)
    assert timing == {
        "cold": True,
        "views": 2,
        "editor": 2,
        "editor_cpu": 20,
        "scene": 5,
        "scene_cpu": 50,
        "rendering": 3,
        "rendering_cpu": 30,
    }


def test_no_stage_of_a_real_run_is_left_out_of_the_time_by_its_name():
    report = Report()
    photos, cameras = packaged_pair()
    asked = {"cameras": cameras, "editor": "recolor", "size": 64, "report": report}
    edit3r.run(photos, "paint everything red", **asked)
    names = {stage.name for stage in report.stages}
    counted = timing_of(report.stages, cold=True, views=2)
    outside = ("start", "read photos", "load components", "check")
    expected = [stage.seconds for stage in report.stages if stage.name not in outside]
    assert {"simplify", "refine"} <= names
    total = counted["editor"] + counted["scene"] + counted["rendering"]
    assert total == pytest.approx(sum(expected))


# ---- the paper's table ----


@pytest.fixture
def tiny_checkpoint(tmp_path):
    """Weights of the paper's network, tiny and random, that name their parts."""
    sizes = {"width": 32, "depth": 1, "heads": 2}
    decoder = {"decoder_width": 24, "decoder_depth": 4, "decoder_heads": 2}
    head = {"feature_width": 8, "point_width": 8, "layer_widths": [4, 4, 8, 8]}
    made = edit3r.build(
        "reconstructor",
        "noposplat",
        backbone={"name": "asymmetric-vit", **sizes, **decoder},
        head={"name": "dpt-gaussian", **head},
        weights="random",
    )
    file = tmp_path / "tiny" / WEIGHTS
    save_weights(file, made.network.state_dict(), made.weights_metadata())
    return str(file)


@pytest.mark.parametrize("label", ["edit3r", "noposplat"])
def test_a_feed_forward_column_of_table_1_is_measured_as_the_network_gives_it(
    label, tiny_checkpoint, manifest_file, tmp_path, monkeypatch
):
    passes = []
    once = GaussianNetwork.reconstruct
    monkeypatch.setattr(
        GaussianNetwork, "reconstruct", lambda *given: passes.append(1) or once(*given)
    )
    changes = {"editor": "oracle", "reconstructor": {"weights": tiny_checkpoint}}
    content = read_yaml(find_config("bench/main"))
    methods = {m.label: m for m in read_methods(content, {label: changes})}
    options = RunOptions(no_effnet=True, edits=3)
    run = BenchRun(manifest_file, methods[label], tmp_path / "out", options)
    rows = run_bench(run).values()
    assert not any(row.failure for row in rows)
    # One pass an edit, also where a mask confines it, as it does these.
    assert len(passes) == len(rows) == 3
    # One Gaussian for each pixel of two inputs of 48 x 48.
    assert {row.facts["gaussians"] for row in rows} == {2 * 48 * 48}
    columns = read_columns([run.out])
    head, _, line = time_table(columns).splitlines()
    by_head = dict(zip(head.split("|"), line.split("|")))
    own = [row.timing for row in rows if not row.timing["cold"]]
    expected = median(one["scene"] / 2 for one in own)
    assert float(by_head[" a view [s wall] "]) == pytest.approx(expected, rel=0.01)
