import json

import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.cli.main import main
from edit3r.kit.photos.camera_files import PosedCamera, read_cameras, write_cameras

NAMES = ("img2", "img10")
SIZE = (48, 64)  # height, width


@pytest.fixture
def scene(tmp_path):
    """Two photos with a red box that moves, its masks, and a camera file."""
    folder, masks = tmp_path / "scene", tmp_path / "masks"
    (folder / "images").mkdir(parents=True)
    (masks / "1").mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name, x in zip(NAMES, (16, 22)):
        photo = rng.integers(90, 110, (*SIZE, 3)).astype(np.uint8)
        photo[12:32, x : x + 20] = (200, 40, 40)
        mask = np.zeros(SIZE, np.uint8)
        mask[12:32, x : x + 20] = 255
        Image.fromarray(photo).save(folder / "images" / f"{name}.png")
        Image.fromarray(mask).save(masks / "1" / f"{name}.png")
    k = np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]])
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 0.25
    cameras = [
        PosedCamera(f"images/{name}.png", SIZE[1], SIZE[0], k, pose)
        for name, pose in zip(NAMES, poses)
    ]
    write_cameras(folder / "cameras.json", cameras)
    return folder


def _run(scene, out, *more) -> int:
    return main(["recolor", str(scene), "--out", str(out), "--quiet", *map(str, more)])


def _pixels(path) -> np.ndarray:
    return np.array(Image.open(path))


def _files(folder) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def test_writes_pictures_masks_recipe_and_cameras(scene, tmp_path):
    out = tmp_path / "out"
    assert _run(scene, out, "--masks", tmp_path / "masks", "--augment") == 0
    for name in NAMES:
        photo, picture = (
            _pixels(scene / "images" / f"{name}.png"),
            _pixels(out / "images" / f"{name}.png"),
        )
        mask = _pixels(out / "masks" / "1" / f"{name}.png")
        assert np.array_equal(mask, _pixels(tmp_path / "masks" / "1" / f"{name}.png"))
        assert np.array_equal(photo[mask == 0], picture[mask == 0])
        assert np.abs(photo[mask > 0].astype(int) - picture[mask > 0]).mean() > 10
        assert (out / "augmented" / f"{name}.png").is_file()
    inside = [
        _pixels(out / "images" / f"{n}.png")[
            _pixels(out / "masks" / "1" / f"{n}.png") > 0
        ]
        for n in NAMES
    ]
    assert np.array_equal(*inside)  # one colour before, one colour after, in both views
    recipe = json.loads((out / "recolor.json").read_text())
    assert [view["objects"] for view in recipe["views"]] == [[1], [1]]
    assert (out / "sheet.png").is_file()


def test_cameras_follow_the_pictures_size_and_keep_their_poses(scene, tmp_path):
    assert (
        _run(scene, tmp_path / "out", "--masks", tmp_path / "masks", "--size", 32) == 0
    )
    before, after = (
        read_cameras(scene / "cameras.json"),
        read_cameras(tmp_path / "out" / "cameras.json"),
    )
    for one, other in zip(before, after, strict=True):
        assert other.file == one.file and (other.width, other.height) == (32, 24)
        assert np.allclose(other.K[:2], one.K[:2] / 2) and np.array_equal(
            other.c2w, one.c2w
        )


@pytest.mark.slow
def test_grabcut_finds_the_object_and_a_replay_gives_the_same_files(scene, tmp_path):
    """Colours, masks and faults come from the recipe; the second run needs no segmenter."""
    first, second = tmp_path / "first", tmp_path / "second"
    loose = ["--set", "filter.min_predicted_iou=0", "--set", "filter.min_stability=0.5"]
    loose += ["--segmenter", "grabcut"]
    assert _run(scene, first, "--seed", 4, "--augment", *loose) == 0
    box = torch.zeros(SIZE)
    box[12:32, 16:36] = 1
    mask = torch.from_numpy(_pixels(first / "masks" / "1" / "img2.png") > 127)
    assert (mask & (box > 0)).sum() / (mask | (box > 0)).sum() > 0.8
    assert _run(scene, second, "--replay", first / "recolor.json", "--augment") == 0
    assert _files(first) == _files(second)


def test_earlier_results_are_replaced_only_when_asked(scene, tmp_path, capsys):
    out, masks = tmp_path / "out", tmp_path / "masks"
    assert _run(scene, out, "--masks", masks) == 0
    before = _files(out)
    assert _run(scene, out, "--masks", masks, "--seed", 1) == 2
    assert "--overwrite" in capsys.readouterr().err and _files(out) == before
    assert _run(scene, out, "--masks", masks, "--seed", 1, "--overwrite") == 0
    assert _files(out) != before


def test_files_of_others_are_never_replaced(scene, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "diary.txt").write_text("mine")
    assert _run(scene, out, "--masks", tmp_path / "masks", "--overwrite") == 2
    assert _files(out) == {"diary.txt": b"mine"}


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--masks", "nowhere"), "nowhere: no such folder of masks"),
        (("--masks", "empty"), "no masks for these photos"),
        (("--set", "filter.area=1"), "recolor.filter.area: unknown setting"),
        (("--set", "segmenter.sise=1"), "segmenter"),
        (("--segmenter", "grabut"), "Did you mean 'grabcut'"),
        (("--seed", "-1"), "--seed: must be at least 0"),
        (("--replay", "missing.json"), "missing.json: cannot be read"),
        (
            ("--replay", "missing.json", "--masks", "empty"),
            "omit --masks and --set",
        ),
    ],
)
def test_wrong_use_is_one_sentence_and_leaves_nothing(
    scene, tmp_path, monkeypatch, capsys, arguments, complaint
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    before = sorted(tmp_path.iterdir())
    assert _run(scene, tmp_path / "out", *arguments) == 2
    assert complaint in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_a_replay_on_other_photos_is_refused(scene, tmp_path, capsys):
    assert _run(scene, tmp_path / "out", "--masks", tmp_path / "masks") == 0
    one = scene / "images" / "img2.png"
    assert (
        _run(one, tmp_path / "again", "--replay", tmp_path / "out" / "recolor.json")
        == 2
    )
    assert "was made for the photos img2, img10; got img2" in capsys.readouterr().err
