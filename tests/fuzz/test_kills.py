"""Commands that are killed while they write leave the old result or the new one, and the next start clears the rest."""

import os
import shutil
import sys
from pathlib import Path

import pytest
import torch

from edit3r.cli.main import main
from edit3r.io import atomic
from edit3r.io.images import packaged_pair
from edit3r.testing.training import tiny_job
from edit3r.training.loop import LoopSettings, Recipe, StepLoss, train
from edit3r.workers import run_resumable

pytestmark = pytest.mark.skipif(atomic.fcntl is None, reason="no file locks here")

STEPS = (0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233)  # of the changes that a command makes on the disk


def killed_at(step, folder, act):
    """Call `act` in a process that ends before its `step`-th change in `folder`; False where it made fewer."""
    child = os.fork()
    if child == 0:
        left = step

        def count(event, arguments):
            nonlocal left
            inside = arguments and isinstance(arguments[0], (str, bytes, Path)) and str(folder) in str(arguments[0])
            writes = event != "open" or bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            if (event.startswith(("open", "os.", "shutil.")) and inside and writes) or event == "ctypes.call_function":
                left -= 1
                if left < 0:
                    os._exit(9)

        torch.set_num_threads(1)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        sys.addaudithook(count)
        try:
            act()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def contents(folder):
    """Every file of the folder and what it holds, but for what differs from run to run: times, random states."""
    skipped = {"run.json", "log.jsonl", "last.pt", atomic.MARKER}
    files = [path for path in folder.rglob("*") if path.is_file() and "tensorboard" not in path.parts]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if path.name not in skipped}


def run_command(out):
    options = ["--size", "64", "--editor", "none", "--rasterizer", "torch", "--quiet", "--overwrite"]
    assert main(["run", *map(str, packaged_pair()[0]), "--out", str(out), *options]) == 0


class _Pull(Recipe):
    """One weight that is pulled towards the number of the batch."""

    def __init__(self):
        torch.manual_seed(0)
        super().__init__(torch.nn.Linear(1, 1))

    def loss(self, step, processes):
        total = ((self.network.weight - step) ** 2).sum()
        return StepLoss(total, {"pull": total})

    def validate(self, step, processes):
        return {"score": -float(step)}


def train_command(out):
    job = tiny_job(out)
    if (out / "last.pt").is_file():
        job = job.__class__(**{**vars(job), "resume": True})
    train(_Pull(), LoopSettings(steps=4, warmup=1, validate_every=2, checkpoint_every=1, log_every=1), job)


def measure_command(out):
    out.mkdir(exist_ok=True)
    run_resumable({name: {"value": value} for value, name in enumerate("abcd")}, dict, out / "rows.jsonl")


@pytest.mark.parametrize("command", [train_command, measure_command])
def test_a_killed_command_leaves_a_whole_result_and_the_next_start_ends_like_a_straight_one(tmp_path, command):
    straight = tmp_path / "straight"
    command(straight)
    killed = 0
    for step in STEPS:
        place = tmp_path / str(step)
        place.mkdir()
        if not killed_at(step, place, lambda: command(place / "out")):  # noqa: B023
            break
        killed += 1
        command(place / "out")
        assert contents(place / "out") == contents(straight), step
        assert [path.name for path in place.iterdir()] == ["out"], step
    assert killed >= 5


def test_a_killed_run_over_an_earlier_one_leaves_that_or_the_new_one(tmp_path):
    old = tmp_path / "old"
    run_command(old)
    for step in (1, 60):
        out = tmp_path / str(step) / "out"
        shutil.copytree(old, out)
        assert killed_at(step, out.parent, lambda: run_command(out))  # noqa: B023
        assert contents(out) == contents(old), step
        run_command(out)
        assert contents(out) == contents(old) and [path.name for path in out.parent.iterdir()] == ["out"], step
