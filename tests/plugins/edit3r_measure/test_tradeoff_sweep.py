import json

import numpy as np
import pytest
import torch
from edit3r_measure import tradeoff_measure
from edit3r_measure.novel_view import RenderedView, score_edit
from edit3r_measure.scene_sources import SceneSource, sample_scene, write_scene
from edit3r_measure.tradeoff_measure import Job, Sweep, measure, perceptual_distance

from edit3r.cli.main import main
from edit3r.contract.interfaces import SceneSample
from edit3r.contract.types import Cameras
from edit3r.geometry.cameras import intrinsics_from_fov
from edit3r.io.posed_folder import Photo
from edit3r.workers import read_rows

JOB = Job(unedited={}, edited={})
POINTS = {"a": {"size": 8}, "b": {"size": 9}}


def sample(views=2, side=8):
    """Grey pictures; only where files go matters."""
    generator = torch.Generator().manual_seed(0)
    pictures = torch.rand(views + 1, 3, side, side, generator=generator)
    poses = torch.eye(4).repeat(1, views + 1, 1, 1)
    poses[0, :, 0, 3] = torch.arange(views + 1)
    k = intrinsics_from_fov(1.0, (side, side)).expand(1, views + 1, 3, 3)
    cameras = Cameras(poses, k, (side, side))
    context = cameras.select(range(views))
    edited = pictures * 0.5
    return SceneSample(
        pictures[:views], pictures[views:], context, cameras.select([views]),
        edited_context=edited[:views], edited_target=edited[views:],
    )  # fmt: skip


@pytest.fixture
def scene(tmp_path):
    source = SceneSource(
        "scene", "procedural", lambda: sample_scene("procedural", 0, [sample()])
    )
    return write_scene(source, tmp_path)


@pytest.fixture
def processes(monkeypatch):
    """Stands in for the child processes; counts them."""
    started = []

    def pretend(job, threads):
        started.append(job.settings["size"])
        return {"psnr": 20.0}

    monkeypatch.setattr(tradeoff_measure, "in_fresh_process", pretend)
    return started


def test_a_scene_on_disk_gives_back_pictures_and_true_cameras(scene):
    inputs, target = scene.truth()
    _, edited = scene.truth(edited=True)
    given = sample()
    assert [file.name for file in scene.photos] == ["0.png", "1.png"]
    assert np.allclose(target.image, given.target[0].permute(1, 2, 0), atol=1 / 255)
    assert np.allclose(
        edited.image, given.edited_target[0].permute(1, 2, 0), atol=1 / 255
    )
    assert inputs[1].c2w[0, 3] == 1 and target.c2w[0, 3] == 2


def test_the_run_gets_no_pose(scene):
    assert all(
        camera["c2w"] is None for camera in json.loads(scene.cameras.read_text())
    )


def test_a_later_sweep_measures_what_is_missing_only(scene, tmp_path, processes):
    sweep = Sweep(tmp_path, JOB)
    sweep.measure({"a": POINTS["a"]}, [scene])
    found = sweep.measure(POINTS, [scene])
    assert processes == [8, 9]
    assert [m["label"] for m in found] == ["a", "b"]


def test_a_line_that_a_kill_cut_short_is_measured_again(scene, tmp_path, processes):
    sweep, file = Sweep(tmp_path, JOB), tmp_path / "measurements.jsonl"
    sweep.measure(POINTS, [scene])
    file.write_text(file.read_text()[:-20])
    assert len(read_rows(file)) == 1
    assert len(sweep.measure(POINTS, [scene])) == 2
    assert processes == [8, 9, 9]
    assert len(read_rows(file)) == 2


def test_no_measurement_starts_after_the_time_is_up(scene, tmp_path, processes):
    assert Sweep(tmp_path, JOB, seconds=0.0).measure(POINTS, [scene]) == []
    assert processes == []


def test_a_key_follows_content_and_not_names(tmp_path):
    sweep = Sweep(tmp_path, JOB)
    key = sweep.key({"size": 8}, "x")
    assert key == Sweep(tmp_path / "elsewhere", JOB).key({"size": 8}, "x")
    others = [sweep.key({"size": 9}, "x"), sweep.key({"size": 8}, "y")]
    assert key not in [
        *others,
        Sweep(tmp_path, Job({}, {}, repeats=9)).key({"size": 8}, "x"),
    ]


def photo(image):
    return Photo(image.astype(np.float32), np.eye(3), np.eye(4))


def test_uptake_and_leak_by_hand():
    before, after = np.full((4, 4, 3), 0.5), np.full((4, 4, 3), 0.5)
    after[:2] += 0.4
    covered = np.ones((4, 4), bool)
    shown = np.full((4, 4, 3), 0.5)
    shown[:2] += 0.1  # a quarter of the edit
    shown[2:] += 0.02  # and some where nothing changed
    score = score_edit(
        RenderedView(before, covered),
        RenderedView(shown, covered),
        photo(before),
        photo(after),
    )
    assert score.uptake == pytest.approx(0.25) and score.leak == pytest.approx(0.02)


def test_what_is_not_covered_counts_for_neither():
    before, after = np.zeros((2, 2, 3)), np.ones((2, 2, 3))
    view = RenderedView(before, np.zeros((2, 2), bool))
    score = score_edit(view, view, photo(before), photo(after))
    assert score.uptake is None and score.leak is None


def test_a_perceptual_distance_that_cannot_be_had_is_said(monkeypatch):
    from edit3r.errors import MissingDependencyError

    class Nothing:
        def build(self, kind, name):
            raise MissingDependencyError(f"{kind} {name} is not here")

    distance = perceptual_distance(
        Nothing(), ["x"], np.zeros((4, 4, 3)), np.zeros((4, 4, 3))
    )
    assert distance["perceptual"] is None and distance["perceptual_missing"] == {
        "x": "loss x is not here"
    }


KNOBS = """
base: {editor: none, reconstructor: edit3r, rasterizer: numba, frames: 2}
unedited: {editor: none}
edited: {editor: {name: folder, path: "{folder}"}, edit_views: first}
datasets: {procedural: {image_size: 96, context: 2, targets: 1, edit: recolor, angles: [6, 10], seed: 4, textures: 8}}
knobs: {size: {about: pixels, values: {"80": {size: 80}}}}
"""


def test_the_command_measures_a_run_in_its_own_process(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("NUMBA_NUM_THREADS", "1")
    (tmp_path / "knobs.yaml").write_text(KNOBS, encoding="utf-8")
    argv = [
        "tradeoff",
        "--data",
        "procedural",
        "--knobs",
        str(tmp_path / "knobs.yaml"),
        "--grid",
        "--scenes",
        "1",
    ]
    argv += [
        "--warm-up",
        "0",
        "--repeats",
        "1",
        "--threads",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(argv) == 0
    (base,) = map(
        json.loads, (tmp_path / "out" / "measurements.jsonl").read_text().splitlines()
    )
    assert base["psnr"] > 15 and base["uptake"] > 0.5 and 0 <= base["leak"] < 0.05
    assert base["memory_mb"] > base["start_memory_mb"] > 50 and base["ply_bytes"] > 1000
    assert {"render", "write files"} <= set(base["runs"][0]["cpu"])
    assert "| size 80 |" in (tmp_path / "out" / "tradeoff.md").read_text()
    assert main([*argv, "--update-presets"]) == 2  # resumes; one point is no choice
    assert "the presets stay as they are" in capsys.readouterr().err


def test_a_run_that_ends_in_a_sentence_is_measured_as_that_sentence(scene, tmp_path):
    files = {"scene": str(scene.path), "image": str(tmp_path / "x.png")}
    answer = measure(Job({}, {}, settings={"reconstructor": "nobody"}, **files))
    assert list(answer) == ["failure"] and answer["failure"].startswith(
        "no reconstructor named 'nobody'."
    )


@pytest.mark.parametrize(
    ("option", "least"),
    [("--repeats", 1), ("--scenes", 1), ("--threads", 1), ("--warm-up", 0)],
)
def test_a_number_too_small_is_one_sentence(option, least, capsys):
    assert main(["tradeoff", option, str(least - 1)]) == 2
    assert f"{option}: must be at least {least}" in capsys.readouterr().err
