"""Commands that are killed while they write leave the old result or the new one.

The next start clears the rest.
"""

import asyncio
import hashlib
import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from edit3r_app.jobs import AppJob, JobsFolder
from edit3r_app.runner import Runner
from edit3r_app.uploads import receive
from edit3r_develop.fetch import fetch
from edit3r_training.loop import LoopSettings, Recipe, StepLoss, train

from edit3r.cli.main import main
from edit3r.contract.weights import Weights
from edit3r.kit.cache import Cache
from edit3r.kit.files import atomic
from edit3r.kit.photos.images import packaged_pair
from edit3r.kit.weights.find import find
from edit3r.kit.workers import run_resumable
from edit3r_testing.training import tiny_job

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")

FLAT = Path(__file__).parents[1] / "plugins" / "flat_scene.py"
STEPS = (0, 1, 2, 3, 5, 8, 13, 21, 34, 55, 89, 144, 233)
"""Of the changes that a command makes on the disk."""


@pytest.fixture
def kills(tmp_path, killed_at):
    """Yield folders in each of which `act(folder)` was killed, at a later step each time."""

    def places(act, steps=STEPS):
        for step in steps:
            place = tmp_path / f"killed-{step}"
            place.mkdir()
            if not killed_at(step, place, lambda: act(place)):  # noqa: B023
                return
            yield place

    return places


def contents(folder):
    """What every file of the folder holds, but for times and random states."""
    skipped = {"run.json", "log.jsonl", "last.pt", atomic.MARKER}
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
        and path.name not in skipped
        and "tensorboard" not in path.parts
    }


def left_in(folder):
    return {path.name for path in folder.iterdir()}


def run_command(out):
    options = (
        "--size 24 --outputs scene --editor none --rasterizer torch --quiet --overwrite "
        f"--refine 0 --frames 2 --plugin {FLAT} --recon flat"
    )
    photos = map(str, packaged_pair()[0])
    assert main(["run", *photos, "--out", str(out), *options.split()]) == 0


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
    settings = LoopSettings(
        steps=4, warmup=1, validate_every=2, checkpoint_every=1, log_every=1
    )
    train(_Pull(), settings, job)


def measure_command(out):
    out.mkdir(exist_ok=True)
    jobs = {name: {"value": value} for value, name in enumerate("abcd")}
    run_resumable(jobs, dict, out / "rows.jsonl")


def cache_command(out):
    cache = Cache()
    for value in range(3):
        cache.recall("depth", str(value), lambda: torch.full((4,), float(value)))  # noqa: B023
    with atomic.atomic_folder(out, overwrite=True) as folder:
        cache.save(folder / "cache")


@pytest.mark.slow
@pytest.mark.parametrize("command", [train_command, measure_command, cache_command])
def test_a_killed_command_is_ended_by_the_next_start_like_a_straight_one(
    tmp_path, kills, command
):
    command(tmp_path / "straight")
    straight = contents(tmp_path / "straight")
    places = []
    for place in kills(lambda place: command(place / "out")):
        out = place / "out"
        whole = command is not cache_command or not out.exists()
        assert whole or contents(out) == straight, place
        command(out)
        assert contents(out) == straight and left_in(place) == {"out"}, place
        places.append(place)
    assert len(places) >= 5


@pytest.mark.slow
def test_a_killed_run_over_an_earlier_one_leaves_that_or_the_new_one(
    tmp_path, killed_at
):
    old, out = tmp_path / "old", tmp_path / "new" / "out"
    run_command(old)
    shutil.copytree(old, out)
    assert killed_at(15, out.parent, lambda: run_command(out))
    assert left_in(out.parent) != {"out"}  # a workspace
    assert contents(out) == contents(old)
    run_command(out)
    assert contents(out) == contents(old) and left_in(out.parent) == {"out"}


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


@pytest.mark.slow
def test_killed_fetching_leaves_no_half_weights_and_the_next_try_ends_it(kills, hub):
    files = tuple((name, "") for name in HUB_FILES)
    weights = Weights(
        "thing", "a test", 10_242, "MIT", "yes", "hub:stand/in", "0" * 40, files
    )

    def fetched(place):
        return {name: (place / name).read_bytes() for name in HUB_FILES}

    places = []
    for place in kills(
        lambda place: fetch(weights, place, report=str), range(0, 200, 3)
    ):
        thing = place / "thing"
        assert not thing.exists() or fetched(thing) == HUB_FILES, place
        assert fetch(weights, place, report=str) == find(weights, place) == thing
        assert fetched(thing) == HUB_FILES, place
        assert left_in(place) <= {"thing", ".lock"}, place
        places.append(place)
    assert len(places) > 5


@pytest.mark.slow
def test_an_app_killed_at_an_upload_or_a_new_job_starts_again_with_whole_ones(kills):
    photo = Path(packaged_pair()[0][0]).read_bytes()

    async def pieces():
        for start in range(0, len(photo), 1 << 16):
            yield photo[start : start + (1 << 16)]

    def act(root):
        folder = JobsFolder(root)
        scene = folder.new_scene("bear")
        asyncio.run(receive(folder, scene, "p.jpg", len(photo), pieces()))
        folder.new_job(AppJob("", scene, settings={"prompt": "paint it red"}))

    seen = set()
    for root in kills(act, range(0, 100, 3)):
        folder = JobsFolder(root)
        Runner(folder).stop()  # it clears up
        kept = [path.read_bytes() for path in root.glob("bear/images/*")]
        asked = [job.prompt for job in folder.jobs()]
        assert kept in ([], [photo]) and asked in ([], ["paint it red"]), root
        seen.add((len(kept), len(asked)))
        left = left_in(folder.private)
        assert not any(name.startswith("upload-") for name in left), (root, left)
        act(root)
    assert seen >= {(0, 0), (1, 0)}
