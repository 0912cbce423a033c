"""What a run is doing, read from its log, and how long it still needs."""

import json
import time

import pytest
from edit3r_app.jobs import AppJob, JobsFolder
from edit3r_app.progress import RunProgress, read_progress, time_left


def event(kind, text, done=0, total=0, at=0.0):
    content = {"event": kind, "text": text, "done": done, "total": total, "at": at}
    return json.dumps(content)


def test_progress_is_read_from_the_log(tmp_path):
    lines = [
        event("start", "edit", at=1.0),
        event("end", "edit", at=3.5),
        event("warn", "dark"),
        event("start", "render", at=4.0),
        "no json",
        "[3]",
        event("progress", "x", 1, 4),
        "edit3r: too dark.",
    ]
    (tmp_path / "log").write_text("\n".join(lines))
    assert read_progress(tmp_path / "log") == RunProgress(
        done={"edit": 2.5},
        stage="render",
        share=0.25,
        whole=(8 + 0.25) / 10,
        since=4.0,
        told=["dark"],
        error="too dark.",
    )
    assert read_progress(tmp_path / "none") == RunProgress()


def test_the_bar_of_a_first_edit_counts_steps_and_never_goes_back():
    progress, seen = RunProgress(), []
    for kind, text, done in (
        ("start", "read scene", 0),
        ("start", "geometry", 0),
        ("progress", "geometry", 3),
        ("progress", "geometry", 1),  # another thing of the same step
        ("start", "edit (recolor)", 0),
        ("start", "simplify", 0),  # a step that not every run has
        ("start", "write files", 0),
    ):
        progress.take(event(kind, text, done, 4))
        seen.append(progress.whole)
    assert seen == [0, 0.2, 0.275, 0.275, 0.4, 0.4, 0.9]


def test_the_time_left_is_that_of_the_newest_run_of_the_same_reconstructor(tmp_path):
    folder = JobsFolder(tmp_path)
    settings = {"reconstructor": {"name": "refit"}}
    run = folder.new_job(AppJob("", "bear", settings=settings))
    (folder.root / run.name).mkdir()
    stages = [{"name": "edit", "seconds": 4.0}, {"name": "render", "seconds": 10.0}]
    (folder.root / run.name / "run.json").write_text(json.dumps({"stages": stages}))
    job = folder.new_job(AppJob("", "bear", settings=settings))
    begun = RunProgress(stage="edit", since=time.time() - 1)
    assert time_left(folder, job, begun) == pytest.approx(13, abs=0.5)
    late = RunProgress(done={"edit": 9}, stage="render", since=time.time() - 20)
    assert time_left(folder, job, late) == 0
    other = folder.new_job(AppJob("", "bear"))
    assert time_left(folder, other, RunProgress()) is None
