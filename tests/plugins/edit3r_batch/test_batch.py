"""`edit3r batch`: each job once, an ordinary run folder each, whoever did it and however often it
was interrupted.
"""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from PIL import Image

from edit3r.cli.main import main
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.scenes.ply import load_ply, save_ply
from tests.plugins.scan import scan

HERE = Path(__file__).parent
SETTINGS = (
    "editor=harmful reconstructor=flat rasterizer=torch refine=0 gaussians=all size=24 "
    "frames=2 outputs=scene,images"
)
QUICK = [f"--set={one}" for one in SETTINGS.split()]
QUICK += [f"--plugin={HERE}/harmful.py", f"--plugin={HERE.parent}/flat_scene.py"]


@pytest.fixture
def place(tmp_path, monkeypatch, forked_workers):
    monkeypatch.setenv("EDIT3R_TEST_LOG", str(tmp_path / "log"))
    for name, photo in zip("ab", packaged_pair()[0]):
        Image.open(photo).resize((48, 32)).save(tmp_path / f"{name}.png")
    return tmp_path


def jobs_file(place, *prompts, **settings):
    lines = [
        {"photos": ["a.png", "b.png"], "prompt": p, "seed": n, **settings}
        for n, p in enumerate(prompts, 1)
    ]
    (place / "jobs.jsonl").write_text(
        "".join(json.dumps(line) + "\n" for line in lines)
    )
    return str(place / "jobs.jsonl")


def batch(file, out, *options):
    return main(["batch", file, "--out", str(out), *QUICK, *options])


def done_seeds(place):
    return sorted(
        int(line.split()[0]) for line in (place / "log").read_text().splitlines()
    )


def is_alive(pid):
    """On Linux; elsewhere nobody waits."""
    try:
        return (
            Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
        )
    except OSError:
        return False


def contents(out):
    """Every file and what it holds, but for the times of run.json and the sizes that the marker
    lists.
    """
    files = [
        path
        for path in out.rglob("*")
        if path.is_file() and path.name not in ("run.json", ".edit3r-run")
    ]
    return {str(path.relative_to(out)): path.read_bytes() for path in files}


@pytest.mark.slow
def test_a_job_leaves_what_a_run_leaves_and_can_be_gone_on_from(place, capsys):
    options = ["--prompt", "make it warmer", "--fov", "50", "--refine", "2"]
    options += ["--size", "64", "--frames", "2"]
    photos = [str(place / "a.png"), str(place / "b.png")]
    assert main(["run", *photos, *options, "--out", str(place / "run"), "--quiet"]) == 0
    for name in ("first", "second"):  # the second finds everything loaded
        line = {"id": name, "photos": ["a.png", "b.png"], "prompt": "make it warmer"}
        with (place / "jobs.jsonl").open("a") as file:
            file.write(
                json.dumps({**line, "fov": 50, "size": 64, "frames": 2, "refine": 2})
                + "\n"
            )
    assert main(["batch", str(place / "jobs.jsonl"), "--out", str(place / "out")]) == 0
    for name in ("first", "second"):
        made = contents(place / "out" / name)
        assert json.loads(made.pop("job.json"))["fov"] == 50
        assert made == contents(place / "run")
    more = f"--from {place}/out/second --out {place}/more --quiet".split()
    assert main(["run", *more, *options[:4]]) == 0
    assert "2 jobs: 2 " in capsys.readouterr().out


@pytest.mark.slow
def test_a_job_that_fails_or_kills_its_worker_is_a_row_and_the_others_are_done(
    place, capsys
):
    file = jobs_file(place, "die", "ok", "fail", "crash", "ok")
    assert batch(file, place / "out", "--workers", "2") == 1
    told = capsys.readouterr()
    assert (
        "3 of 5 jobs gave no result" in told.err
        and "5 jobs: 3 no result, 2 " in told.out
    )
    summary = json.loads((place / "out" / "summary.json").read_text())
    reasons = [row["reason"] for row in summary["rows"]]
    assert (
        "worker process died" in reasons[0]
        and reasons[2] == "the model | is not in the mood."
    )
    assert "ZeroDivisionError" in reasons[3] and summary["verdicts"]["no result"] == 3
    assert r"the model \| is" in (place / "out" / "summary.md").read_text()
    folders = {path.name for path in (place / "out").iterdir() if path.is_dir()}
    assert folders == {"job-000002", "job-000005"}


@pytest.mark.slow
def test_jobs_are_done_again_that_failed_are_gone_or_changed(place, capsys):
    """Those with other settings only with `--overwrite`."""
    assert batch(jobs_file(place, "a", "b", "fail", "d"), place / "out") == 1
    before = contents(place / "out")
    changed = jobs_file(place, "a", "x", "fail", "d")
    assert batch(changed, place / "out") == 2
    assert (
        "line 2: 'job-000002' was done with another prompt; give"
        in capsys.readouterr().err
    )
    assert contents(place / "out") == before
    (place / "out" / "job-000001").rename(place / "elsewhere")
    assert batch(changed, place / "out", "--overwrite") == 1
    assert done_seeds(place) == [1, 1, 2, 2, 3, 3, 4]
    record = json.loads((place / "out" / "job-000002" / "job.json").read_text())
    assert record["prompt"] == "x"
    assert (place / "out" / "job-000001" / "run.json").is_file()


def test_a_folder_that_is_no_job_is_left_alone(place, capsys):
    (place / "out" / "job-000002").mkdir(parents=True)
    (place / "out" / "job-000002" / "thesis.tex").write_text("mine")
    assert batch(jobs_file(place, *"ab"), place / "out", "--overwrite") == 2
    assert (
        "thesis.tex" in capsys.readouterr().err
        and not (place / "out" / "job-000001").exists()
    )


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "killpg"), reason="no process groups here")
def test_a_killed_batch_of_two_workers_leaves_what_a_straight_one_of_one_worker_leaves(
    place,
):
    file = jobs_file(place, *["wait"] * 6)
    command = [sys.executable, "-m", "edit3r", "batch", file, "--workers=2", *QUICK]
    child = subprocess.Popen([*command, f"--out={place}/out", "--quiet"])
    while sum(path.name == "run.json" for path in place.glob("out/job-*/*")) < 3:
        assert child.poll() is None
        time.sleep(0.02)
    child.kill()
    child.wait()
    workers = {
        int(line.split()[1]) for line in (place / "log").read_text().splitlines()
    }
    end = time.monotonic() + 60
    while any(map(is_alive, workers)):  # they end with the process that started them
        assert time.monotonic() < end
        time.sleep(0.02)
    finished = {path.name: path.stat().st_ino for path in (place / "out").glob("job-*")}
    assert 3 <= len(finished) < 6
    assert batch(file, place / "out") == 0
    assert {name: (place / "out" / name).stat().st_ino for name in finished} == finished
    assert len(done_seeds(place)) <= 6 + 2  # at most the two that were in the middle
    (place / "log").unlink()
    assert batch(file, place / "straight") == 0
    assert contents(place / "out") == contents(place / "straight")
    loaded = {line.split()[2] for line in (place / "log").read_text().splitlines()}
    assert len(loaded) == 1  # for all jobs
    assert not [path for path in (place / "out").iterdir() if "partial" in path.name]


@pytest.mark.slow
def test_what_a_worker_left_that_was_killed_after_its_last_step_is_removed(place):
    """Its folder was in place already, so nobody does the job again."""
    file = jobs_file(place, "a")
    assert batch(file, place / "out") == 0
    left = place / "out" / ".job-000001.partial-0badcafe"
    left.mkdir()
    (left / "edit3r.lock").touch()
    assert batch(file, place / "out") == 0 and not left.exists()
    assert len(done_seeds(place)) == 1


def test_two_batches_in_one_folder_are_refused(place, capsys):
    from filelock import FileLock

    (place / "out").mkdir()
    with FileLock(place / "out" / ".edit3r.lock"):
        assert batch(jobs_file(place, "a"), place / "out") == 2
    assert "another run writes its results there" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, said",
    [
        (["--gpus-per-worker", "1"], "give --ray too"),
        (["--memory-per-worker", "-1", "--ray"], "must be 0 or more"),
        (["--gpus-per-worker", "1.5", "--ray"], "a part of one GPU"),
        (["--workers", "0"], "at least 1"),
    ],
)
def test_workers_that_cannot_be_asked_for_are_told_before_anything_runs(
    place, capsys, options, said
):
    assert batch(jobs_file(place, "a"), place / "out", *options) == 2
    assert said in capsys.readouterr().err and not (place / "out").exists()


@pytest.mark.slow
def test_a_splat_in_place_of_photos_is_a_job_too(place):
    save_ply(place / "scan.ply", scan())
    file = place / "jobs.jsonl"
    job = {"photos": ["scan.ply"], "prompt": "make everything black and white"}
    file.write_text(json.dumps({**job, "id": "grey"}))
    sizes = ["--set", "size=32", "--set", "views=3", "--set", "outputs=scene"]
    assert main(["batch", str(file), "--out", str(place / "out"), *sizes]) == 0
    after = load_ply(place / "out" / "grey" / "scene.ply")
    assert torch.equal(after.means, scan().means)
    spread = after.harmonics[0, :, 0].amax(1) - after.harmonics[0, :, 0].amin(1)
    assert spread.median() < 0.1
