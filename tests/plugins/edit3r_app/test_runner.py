"""The queue: one at a time, in order; cancelled, failed and interrupted runs leave a sentence and
no half result.
"""

import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from edit3r_app import runner as runner_module
from edit3r_app.jobs import AppJob, JobsFolder
from edit3r_app.progress import read_progress
from edit3r_app.runner import OUTPUTS, Runner, command_of

from edit3r.contract.errors import InputError
from edit3r.kit.children import PYTHON
from edit3r.running import CACHE

TAKE = "import sys; from edit3r_app.ready import take; sys.argv[1:] = take()\n"
QUICK = """
import pathlib, sys
out = pathlib.Path(sys.argv[sys.argv.index('--out') + 1])
out.mkdir()
(out / 'run.json').write_text('{}')
"""
SLOW = """
import pathlib, sys, time
out = pathlib.Path(sys.argv[sys.argv.index('--out') + 1])
partial = out.with_name(f".{out.name}.partial-00000000")
partial.mkdir()
event = '{"event": "start", "text": "edit", "done": 0, "total": 0, "at": 1.0}'
print(event, file=sys.stderr, flush=True)
time.sleep(60)
"""
WRONG = "import sys; print('noise'); print('edit3r: too dark.', file=sys.stderr); sys.exit(2)"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    # the suite may run where SIGINT is ignored
    monkeypatch.setattr(runner_module, "PATIENCE", 0.5)
    return JobsFolder(tmp_path)


def runner_of(folder, program):
    return Runner(folder, (sys.executable, "-c", TAKE + program))


def queued(folder, scene=None, **job):
    return folder.new_job(AppJob("", scene or folder.new_scene("bear"), **job))


def test_a_strangers_record_writes_nothing_through_its_links(folder, tmp_path):
    job = queued(folder, settings={"prompt": "alias ls=rm"})
    theirs = [tmp_path / name for name in ("profile", "notes")]
    links = (folder.beside(job.name) / "settings.yaml", folder.log(job.name))
    for file, link in zip(theirs, links):
        file.write_text("mine")
        link.symlink_to(file)
    runner = runner_of(folder, QUICK)
    wait_until(runner, lambda: folder.job(job.name).state == "done")
    assert [file.read_text() for file in theirs] == ["mine", "mine"]


def wait_until(runner, condition, most=30):
    end = time.monotonic() + most
    while time.monotonic() < end:
        runner.step()
        if condition():
            return
        time.sleep(0.02)
    raise AssertionError("did not happen")


def states(folder):
    return [job.state for job in folder.jobs()]


def test_jobs_run_one_after_the_other(folder):
    runner, first = runner_of(folder, QUICK), queued(folder)
    queued(folder, first.scene)
    seen = set()
    wait_until(
        runner,
        lambda: seen.add(tuple(states(folder))) or states(folder) == ["done", "done"],
    )
    assert ("running", "running") not in seen
    runner.stop()


def test_a_run_that_fails_tells_its_own_sentence(folder):
    runner, job = runner_of(folder, WRONG), queued(folder)
    wait_until(runner, lambda: states(folder) == ["failed"])
    assert folder.job(job.name).sentence == "too dark."
    runner.stop()


def begun(folder, job):
    return lambda: read_progress(folder.log(job.name)).stage == "edit"


def test_a_cancelled_run_ends_and_leaves_nothing_half_written(folder):
    runner, job = runner_of(folder, SLOW), queued(folder)
    wait_until(runner, begun(folder, job))
    _, child = runner._running
    runner.cancel(job.name)
    assert states(folder) == ["cancelled"] and not list(folder.root.glob(".*partial*"))
    assert child.poll() is not None
    runner.stop()


KILLED_CHILD = f"{SLOW.replace('time.sleep(60)', 'import os; os.kill(os.getpid(), 9)')}"


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_the_workspace_of_a_killed_run_does_not_stay(folder):
    runner, job = runner_of(folder, KILLED_CHILD), queued(folder)
    wait_until(runner, lambda: states(folder) == ["failed"])
    assert begun(folder, job)()
    assert not list(folder.root.glob(".*partial*"))
    runner.stop()


def test_a_waiting_job_can_be_cancelled(folder):
    runner, job = runner_of(folder, QUICK), queued(folder)
    runner.cancel(job.name)
    runner.step()
    assert states(folder) == ["cancelled"] and not (folder.root / job.name).exists()
    runner.stop()


def test_a_server_that_is_stopped_queues_its_run_again(folder):
    runner, job = runner_of(folder, SLOW), queued(folder)
    wait_until(runner, begun(folder, job))
    runner.stop()
    assert states(folder) == ["queued"] and not list(folder.root.glob(".*partial*"))
    again = runner_of(folder, QUICK)
    wait_until(again, lambda: states(folder) == ["done"])
    again.stop()


KILLED = """
import sys, time
from edit3r_app.jobs import JobsFolder
from edit3r_app.runner import Runner
runner = Runner(JobsFolder(sys.argv[1]), (sys.executable, "-c", sys.argv[2]))
runner.step()
print(runner._running[1].pid, flush=True)
time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
def test_the_run_of_a_killed_server_ends_and_is_taken_up_again(folder):
    job = queued(folder)
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder.root), TAKE + SLOW],
        stdout=subprocess.PIPE,
    ) as server:
        child = Path("/proc", server.stdout.readline().decode().strip())
        while not begun(folder, job)():
            time.sleep(0.02)
        server.kill()
    for _ in range(1000):
        if not child.exists() or " Z " in (child / "stat").read_text():
            break
        time.sleep(0.02)
    else:
        raise AssertionError("it goes on")
    again = runner_of(folder, QUICK)
    assert states(folder) == ["queued"] and not list(folder.root.glob(".*partial*"))
    wait_until(again, lambda: states(folder) == ["done"])
    again.stop()


def test_two_servers_do_not_share_a_folder(folder):
    runner = runner_of(folder, QUICK)
    with pytest.raises(InputError, match="another `edit3r app`"):
        runner_of(folder, QUICK)
    runner.stop()
    runner_of(folder, QUICK).stop()


def test_the_command_names_photos_masks_settings_and_the_earlier_run(folder):
    scene = folder.new_scene("bear")
    photo = folder.path(scene) / "images" / "a.png"
    photo.write_bytes(b"")
    asked = AppJob("", scene, settings={"prompt": "gold"}, size=96)
    command = command_of(folder, folder.new_job(asked, torch.ones(2, 4, 4)))
    assert str(photo) in command and "--from" not in command
    masks = [Path(file) for file in command[command.index("--mask") + 1 :]]
    assert [mask.name for mask in masks] == ["000.png", "001.png"]
    assert all(mask.is_file() for mask in masks)
    settings = command[command.index("--config") + 1]
    outputs = "".join(f"- {one}\n" for one in OUTPUTS)
    written = f"outputs:\n{outputs}prompt: gold\nsize: 96\n"
    assert "video" not in OUTPUTS and Path(settings).read_text() == written
    command = command_of(folder, queued(folder, scene, parent=scene))
    assert (
        command[command.index("--from") + 1] == str(folder.path(scene))
        and str(photo) not in command
    )


def test_what_was_read_from_the_photos_lies_where_the_run_finds_it(folder, tmp_path):
    known = tmp_path / CACHE
    known.mkdir()
    (known / "match-0.safetensors").write_bytes(b"x")
    asked = AppJob("", folder.new_scene("bear"))
    command = command_of(folder, folder.new_job(asked, torch.ones(2, 4, 4), known))
    beside = Path(command[command.index("--mask") + 1]).parent
    assert (beside / CACHE / "match-0.safetensors").is_file()


def test_a_damaged_record_does_not_stop_the_queue(folder):
    damaged = queued(folder)
    record = folder.private / f"{damaged.name}.json"
    record.write_text(record.read_text().replace('"masks": 0', '"masks": "x"'))
    runner = runner_of(folder, QUICK)
    job = queued(folder)
    wait_until(runner, lambda: folder.job(job.name).state == "done")
    runner.stop()


def test_a_child_imports_nothing_from_the_current_folder(tmp_path):
    (tmp_path / "yaml.py").write_text("raise SystemExit('ran')")
    call = [*PYTHON, "-m", "edit3r", "--version"]
    child = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True)
    assert child.returncode == 0
    assert "ran" not in child.stderr
