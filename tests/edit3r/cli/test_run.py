"""`edit3r run`: what its flags mean for the stages."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch
from PIL import Image

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import RunError
from edit3r.kit.photos.camera_files import posed_cameras, read_cameras, write_cameras
from edit3r.kit.photos.images import save_image
from edit3r.running import pipeline


@pytest.fixture(scope="module")
def posed_photos(tmp_path_factory):
    """Two photos of a generated scene, and a file with their poses, the second one off by a degree
    and a half.
    """
    folder = tmp_path_factory.mktemp("posed")
    sample = edit3r.build(
        "dataset", "procedural", image_size=128, scenes=1, seed=3, textures=8
    )[0]
    names = [f"{index}.png" for index in range(len(sample.context))]
    for name, image in zip(names, sample.context):
        save_image(image, folder / name)
    cameras = sample.context_cameras
    write_cameras(folder / "true.json", posed_cameras(cameras, names))
    angle = torch.tensor(1.5).deg2rad()
    turn = torch.eye(4)
    turn[0, 0], turn[0, 2], turn[2, 0], turn[2, 2] = (
        angle.cos(),
        angle.sin(),
        -angle.sin(),
        angle.cos(),
    )
    cameras.c2w[0, 1] = cameras.c2w[0, 1] @ turn
    write_cameras(folder / "given.json", posed_cameras(cameras, names))
    return folder


def run(folder, out, *options):
    photos = [str(path) for path in sorted(folder.glob("?.png"))]
    quick = [
        "--editor",
        "none",
        "--frames",
        "2",
        "--outputs",
        "scene",
        "--gaussians",
        "all",
        "--refine",
        "0",
    ]
    assert (
        main(["run", *photos, "--out", str(out), *quick, "--size", "128", *options])
        == 0
    )
    given, found = (
        read_cameras(folder / "given.json"),
        read_cameras(out / "cameras.json"),
    )
    relative = np.linalg.inv(given[0].c2w) @ given[1].c2w
    return relative, found[1].c2w, json.loads((out / "run.json").read_text())


@pytest.mark.slow
def test_poses_of_a_given_camera_file_are_used_as_they_are(
    posed_photos, tmp_path, capsys
):
    given, used, manifest = run(
        posed_photos, tmp_path / "out", "--cameras", str(posed_photos / "given.json")
    )
    np.testing.assert_allclose(used, given, atol=2e-6)
    assert manifest["notes"]["poses.source"].startswith("those that were given")
    assert "poses: those that were given" in capsys.readouterr().err


def test_refine_poses_brings_the_given_ones_back_and_says_how_far(
    posed_photos, tmp_path, capsys
):
    given, used, manifest = run(
        posed_photos,
        tmp_path / "out",
        "--cameras",
        str(posed_photos / "given.json"),
        "--refine-poses",
    )
    first, second = (camera.c2w for camera in read_cameras(posed_photos / "true.json"))
    true = (np.linalg.inv(first) @ second)[:3, :3]
    off, left = (
        np.degrees(np.arccos((np.trace(c2w[:3, :3].T @ true) - 1) / 2))
        for c2w in (given, used)
    )
    assert off > 1.4 and left < 0.4
    assert np.linalg.norm(used[:3, 3]) == pytest.approx(
        np.linalg.norm(given[:3, 3]), rel=0.02
    )
    assert manifest["notes"]["poses.refined"].startswith("turned by up to 1.")
    assert "as they are" not in manifest["notes"]["poses.source"]


def test_a_wrong_file_name_is_said_before_torch_is_imported(tmp_path):
    """Which takes seconds: within some tenths of one instead."""
    code = (
        "import sys; from edit3r.cli.main import main; "
        "code = main(['run', 'nope.jpg', '--out', sys.argv[1]]); "
        "print(code, 'torch' in sys.modules)"
    )
    asked = [sys.executable, "-c", code, str(tmp_path / "out")]
    done = subprocess.run(asked, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["2", "False"]
    assert "nope.jpg: no such file or folder" in done.stderr


def test_edits_outlive_a_step_that_fails_after_them(tmp_path, capsys, monkeypatch):
    """An editor may take minutes or money: its pictures are kept, and lead to the same scene."""
    asked = ["run", "--size", "128", "--outputs", "images", "--refine", "0"]

    def broken(*_):
        raise RunError("the card is gone.")

    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "reconstruct", broken)
        options = ["--prompt", "make everything grey", "--out", str(tmp_path / "out")]
        assert main([*asked, *options]) == 1
    kept = tmp_path / "out-edits"
    said = capsys.readouterr().err
    assert f"the card is gone. The edited photos are in {kept}" in said
    assert [path.name for path in tmp_path.iterdir()] == ["out-edits"]
    # The command that the message gives, and the scene is grey.
    options = ["--editor", "folder", "--set", f"editor.path={kept}"]
    assert main([*asked, *options, "--out", str(tmp_path / "again")]) == 0
    edited = np.asarray(Image.open(next((tmp_path / "again/edited").iterdir())))
    assert np.ptp(edited.astype(int), axis=-1).max() <= 1


def test_nothing_is_kept_of_a_run_that_edited_nothing(tmp_path, monkeypatch):
    def broken(*_):
        raise RunError("the card is gone.")

    monkeypatch.setattr(pipeline, "reconstruct", broken)
    asked = ["run", "--size", "128", "--editor", "none"]
    assert main([*asked, "--out", str(tmp_path / "out")]) == 1
    assert not list(tmp_path.iterdir())


def test_refine_poses_without_poses_is_an_error(posed_photos, tmp_path, capsys):
    photos = [str(path) for path in sorted(posed_photos.glob("?.png"))]
    options = ["--out", str(tmp_path / "out"), "--editor", "none", "--refine-poses"]
    assert main(["run", *photos, *options]) == 2
    assert "--cameras" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_matcher_that_was_chosen_stays(posed_photos, tmp_path):
    options = [
        "--cameras",
        str(posed_photos / "given.json"),
        "--matcher",
        "classical",
    ]
    given, used, _ = run(posed_photos, tmp_path / "out", *options)
    assert np.abs(used - given).max() > 1e-3


@pytest.mark.slow
def test_naming_the_default_matcher_makes_the_same_scene(tmp_path):
    scenes = []
    for name, options in {"named": ["--matcher", "classical"], "not": []}.items():
        asked = ["run", "--size", "96", "--editor", "none", "--outputs", "scene"]
        assert main([*asked, *options, "--out", str(tmp_path / name)]) == 0
        scenes.append((tmp_path / name / "scene.ply").read_bytes())
    assert scenes[0] == scenes[1]


@pytest.mark.parametrize(
    "name, said", [("a.png", "one of the photos"), ("look.pdf", "name of an image")]
)
def test_a_preview_is_an_image_and_replaces_no_photo(tmp_path, capsys, name, said):
    for photo in ("a.png", "b.png"):
        Image.new("RGB", (8, 8)).save(tmp_path / photo)
    before = (tmp_path / "a.png").read_bytes()
    words = ["--preview", str(tmp_path / name), "--overwrite"]
    assert main(["run", str(tmp_path), *words]) == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / "a.png").read_bytes() == before


def test_a_preview_is_one_image_file_and_nothing_in_3d(posed_photos, tmp_path, capsys):
    photos = [str(path) for path in sorted(posed_photos.glob("?.png"))]
    sheet = tmp_path / "preview.PNG"
    words = ["--prompt", "make it darker", "--out", str(tmp_path / "out")]
    assert main(["run", *photos, *words, "--preview", str(sheet)]) == 0
    assert sheet.is_file() and not (tmp_path / "out").exists()
    assert "reconstruct (" not in capsys.readouterr().err
