"""Commands that are killed while they write leave the old result or the new one, and the next start
clears the rest.
"""

import asyncio
import hashlib
import os
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from edit3r_app.jobs import Job, JobsFolder
from edit3r_app.runner import Runner
from edit3r_app.uploads import receive
from edit3r_training.loop import LoopSettings, Recipe, StepLoss, train

from edit3r.cache import Cache
from edit3r.cli.main import main
from edit3r.contract.weights import Weights
from edit3r.io import atomic
from edit3r.io.cameras import posed_cameras, write_cameras
from edit3r.io.fetching import fetch
from edit3r.io.images import packaged_pair
from edit3r.io.ply import save_ply
from edit3r.plugins.weights import find
from edit3r.workers import run_resumable
from edit3r_testing import cameras_around, gaussian_cloud
from edit3r_testing.training import tiny_job

pytestmark = pytest.mark.skipif(atomic.fcntl is None, reason="no file locks here")

FLAT = str(Path(__file__).parents[1] / "plugins" / "flat_scene.py")
STEPS = (
    0,
    1,
    2,
    3,
    5,
    8,
    13,
    21,
    34,
    55,
    89,
    144,
    233,
)  # of the changes that a command makes on the disk


def killed_at(step, folder, act):
    """Call `act` in a process that ends before its `step`-th change in `folder`; False where it
    made fewer.
    """
    child = os.fork()
    if child == 0:
        left = step

        def count(event, arguments):
            nonlocal left
            inside = (
                arguments
                and isinstance(arguments[0], (str, bytes, Path))
                and str(folder) in str(arguments[0])
            )
            writes = event != "open" or bool(
                arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
            )
            if (
                event.startswith(("open", "os.", "shutil.")) and inside and writes
            ) or event == "ctypes.call_function":
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
    """Every file of the folder and what it holds, but for what differs from run to run: times,
    random states.
    """
    skipped = {"run.json", "log.jsonl", "last.pt", atomic.MARKER}
    files = [
        path
        for path in folder.rglob("*")
        if path.is_file() and "tensorboard" not in path.parts
    ]
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in files
        if path.name not in skipped
    }


def run_command(out):
    options = [
        "--size",
        "64",
        "--editor",
        "none",
        "--rasterizer",
        "torch",
        "--quiet",
        "--overwrite",
    ]
    options += ["--refine", "0", "--frames", "2", "--plugin", FLAT, "--recon", "flat"]
    assert (
        main(["run", *map(str, packaged_pair()[0]), "--out", str(out), *options]) == 0
    )


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
    train(
        _Pull(),
        LoopSettings(
            steps=4, warmup=1, validate_every=2, checkpoint_every=1, log_every=1
        ),
        job,
    )


def measure_command(out):
    out.mkdir(exist_ok=True)
    run_resumable(
        {name: {"value": value} for value, name in enumerate("abcd")},
        dict,
        out / "rows.jsonl",
    )


@pytest.mark.parametrize("command", [train_command, measure_command])
def test_a_killed_command_leaves_a_whole_result_and_the_next_start_ends_like_a_straight_one(
    tmp_path, command
):
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
        assert contents(out) == contents(old) and [
            path.name for path in out.parent.iterdir()
        ] == ["out"], step


def cache_command(out):
    cache = Cache()
    for value in range(3):
        cache.recall("depth", str(value), lambda: torch.full((4,), float(value)))  # noqa: B023
    with atomic.atomic_folder(out, overwrite=True) as folder:
        cache.save(folder / "cache")


def test_a_cache_killed_while_it_is_saved_is_whole_or_not_there(tmp_path):
    cache_command(tmp_path / "straight")
    killed = 0
    for step in STEPS:
        out = tmp_path / str(step) / "out"
        out.parent.mkdir()
        if not killed_at(step, out.parent, lambda: cache_command(out)):  # noqa: B023
            break
        killed += 1
        assert not out.exists() or contents(out) == contents(tmp_path / "straight"), (
            step
        )
        cache_command(out)
        assert (
            contents(out) == contents(tmp_path / "straight")
            and len(list(out.parent.iterdir())) == 1
        ), step
    assert killed >= 5


def test_a_killed_simplify_leaves_the_old_scene_or_the_new_one(tmp_path):
    old, cameras = tmp_path / "old.ply", cameras_around(2)
    save_ply(old, gaussian_cloud(300))
    write_cameras(tmp_path / "cameras.json", posed_cameras(cameras, ["a.png", "b.png"]))
    options = [
        "--cameras",
        str(tmp_path / "cameras.json"),
        "--gaussians",
        "100",
        "--rasterizer",
        "torch",
        "--quiet",
    ]
    place = tmp_path / "place"
    place.mkdir()
    out, seen = place / "small.ply", set()

    def command():
        assert main(["simplify", str(old), "--out", str(out), *options]) == 0

    for step in STEPS:
        shutil.copyfile(old, out)
        killed = killed_at(step, place, command)
        seen.add(out.read_bytes())
        if not killed:
            break
    command()
    assert seen == {old.read_bytes(), out.read_bytes()} and step > 2
    assert [path.name for path in place.iterdir()] == ["small.ply"]


HUB_FILES = {"config.json": b"{}", "model.bin": bytes(range(256)) * 40}


@pytest.fixture
def hub(monkeypatch):
    """A model hub of two files in place of the client's calls; what is fetched comes in pieces."""

    def sibling(name, content):
        return SimpleNamespace(
            rfilename=name,
            lfs=SimpleNamespace(sha256=hashlib.sha256(content).hexdigest()),
            size=len(content),
        )

    def http_get(url, file, resume_size, **_):
        rest = HUB_FILES[url.rpartition("/")[2]][resume_size:]
        for start in range(0, len(rest), 2048):
            file.write(rest[start : start + 2048])
            file.flush()
            os.utime(file.name)  # an event that a kill can come at

    about = SimpleNamespace(
        sha="0" * 40, siblings=[sibling(*one) for one in HUB_FILES.items()]
    )
    monkeypatch.setattr("huggingface_hub.HfApi.model_info", lambda *_, **__: about)
    monkeypatch.setattr("huggingface_hub.file_download.http_get", http_get)


def test_killed_fetching_leaves_no_half_weights_and_the_next_try_ends_it(tmp_path, hub):
    files = tuple((name, "") for name in HUB_FILES)
    weights = Weights(
        "thing", "a test", 10_242, "MIT", "yes", "hub:stand/in", "0" * 40, files
    )
    killed = 0
    for step in range(200):
        place = tmp_path / str(step)
        place.mkdir()
        if not killed_at(step, place, lambda: fetch(weights, place, report=str)):  # noqa: B023
            break
        killed += 1
        if (place / "thing").exists():
            assert {
                name: (place / "thing" / name).read_bytes() for name in HUB_FILES
            } == HUB_FILES, step
        got = fetch(weights, place, report=str)
        assert got == find(weights, place)
        assert {name: (got / name).read_bytes() for name in HUB_FILES} == HUB_FILES, (
            step
        )
        assert {path.name for path in place.iterdir()} <= {"thing", ".lock"}, step
    assert killed > 15


def test_an_app_killed_in_the_middle_of_an_upload_or_a_new_job_starts_again_with_whole_ones(
    tmp_path,
):
    photo = Path(packaged_pair()[0][0]).read_bytes()

    async def pieces():
        for start in range(0, len(photo), 1 << 16):
            yield photo[start : start + (1 << 16)]

    def act(root):
        folder = JobsFolder(root)
        scene = folder.new_scene("bear")
        asyncio.run(receive(folder, scene, "p.jpg", len(photo), pieces()))
        folder.new_job(Job("", scene, settings={"prompt": "paint it red"}))

    seen = set()
    for step in range(100):
        root = tmp_path / str(step)
        root.mkdir()
        killed = killed_at(step, root, lambda: act(root))  # noqa: B023
        folder = JobsFolder(root)
        runner = Runner(folder)
        runner.clear_left_over()
        runner.stop()
        kept = [path.read_bytes() for path in root.glob("bear/images/*")]
        asked = [job.prompt for job in folder.jobs()]
        assert kept in ([], [photo]) and asked in ([], ["paint it red"]), step
        seen.add((len(kept), len(asked)))
        left = {path.name for path in folder.private.iterdir()}
        assert not any(name.startswith("upload-") for name in left), (step, left)
        act(root)
        if not killed:
            break
    assert seen == {(0, 0), (1, 0), (1, 1)}
