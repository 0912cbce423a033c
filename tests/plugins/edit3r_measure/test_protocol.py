"""NoPoSplat's protocol: index files, overlap, cameras aligned with their photos, areas under curves
of errors.
"""

import json
import sys
from dataclasses import replace
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from edit3r_measure.protocol import (
    IndexEntry,
    PairProtocol,
    align,
    auc,
    photos_of,
    pose_error,
    read_index,
    structure_likeness,
)
from edit3r_measure.scene_sources import photo_scene
from PIL import Image

from edit3r.cli.main import main
from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.rotations import matrices_to_quats, quats_to_matrices
from edit3r.kit.photos.posed_folder import PosedPhoto
from edit3r.loading.registry import build

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.fixture
def indexing(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    path = str(BENCHMARKS / "poses.py")
    return SourceFileLoader("poses_script", path).load_module()


# ---- index files ----


@pytest.mark.parametrize(
    ("name", "overlaps"),
    [
        ("small", (0.05, 0.3, "small")),
        ("medium", (0.31, 0.55)),
        ("large", (0.56, 0.8)),
        ("not classed", (0.81, 0.04, -1.0, None, "huge")),
    ],
)
def test_classes_of_overlap_are_those_of_the_paper(name, overlaps):
    for overlap in overlaps:
        entry = IndexEntry(context=(0, 5), target=(2,), overlap=overlap)
        assert entry.overlap_class == name


def test_an_index_of_pixelsplat_is_read_scenes_without_a_pair_left_out(tmp_path):
    first = {"context": [0, 50], "target": [10, 20, 30], "overlap": 0.4, "fps": 30}
    two = [{"context": [1, 2], "target": 3}, {"context": [4, 8], "target": [5]}]
    content = {"a": first, "b": None, "c": two}
    (tmp_path / "index.json").write_text(json.dumps(content))
    pairs = read_index(tmp_path / "index.json")
    found = [(scene, entry.context, entry.targets) for scene, entry in pairs]
    assert found[0] == ("a", (0, 50), (10, 20, 30))
    assert found[1:] == [("c", (1, 2), (3,)), ("c", (4, 8), (5,))]


@pytest.mark.parametrize(
    "content",
    ["[]", '{"a": 3}', "{", '{"a": {"context": [-1, 2], "target": 0}}'],
)
def test_a_file_that_is_no_index_is_one_sentence(tmp_path, content, folder, capsys):
    index = tmp_path / "index.json"
    index.write_text(content)
    assert main(["evaluate", str(folder.path), "--index", str(index)]) == 2
    assert "index.json" in capsys.readouterr().err


def test_scenes_are_found_by_name_as_folders_given_or_inside_them(folder):
    for place in (folder.path, folder.path.parent):
        first, second = photos_of([str(place)], "wall", (0, 2), 32)
        assert np.array_equal(second.c2w, folder.cameras[2].c2w)
        assert first.image.shape == (32, 32, 3)
    with pytest.raises(InputError, match="frame 3, it has 3 photos"):
        photos_of([str(folder.path)], "wall", (0, 3), 32)
    with pytest.raises(InputError, match="nowhere"):
        photos_of([str(folder.path)], "nowhere", (0, 1), 32)


def straight(x, size=40):
    """A camera that looks at a wall from the front, with a field of view as wide as the wall's
    distance.
    """
    c2w = np.eye(4)
    c2w[0, 3] = x
    lens = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    return PosedPhoto(np.zeros((size, size, 3), np.float32), lens, c2w)


@pytest.mark.parametrize("share", [0.25, 0.5, 1.0])
def test_overlap_is_the_share_of_the_wall_that_both_photos_show(share, indexing):
    wall = np.full((40, 40), 2.0)  # seen 2 wide
    photos = [straight(0), straight(2 * (1 - share))]
    assert indexing.overlap(photos, [wall, wall]) == pytest.approx(share, abs=0.03)


def test_what_something_hides_in_the_other_photo_is_no_overlap(indexing):
    wall, board = np.full((40, 40), 2.0), np.full((40, 40), 2.0)
    # hides half of the wall from the second photo, which the first does not show
    board[:, 20:] = 1.0
    found = indexing.overlap([straight(0), straight(0)], [wall, board])
    assert found == pytest.approx(0.5, abs=0.01)


def test_an_index_is_made_of_a_folder_and_can_be_read_again(
    wall, tmp_path, indexing, monkeypatch
):
    place = tmp_path / "straight"
    place.mkdir()
    cameras = [wall.camera(0.6 * i, 0, f"{i}.png") for i in range(3)]
    (place / "cameras.json").write_text(json.dumps(wall.written(place, cameras)))
    out = tmp_path / "index.json"
    words = [str(place), "--size", "96", "--out", str(out)]
    monkeypatch.setattr(sys, "argv", ["poses.py", *words])
    indexing.index()
    # the squares show 3.2 of the wall each, 1.2 apart
    ((scene, entry),) = read_index(out)
    assert (scene, entry.context, entry.targets) == ("straight", (0, 2), (1,))
    assert entry.overlap_class == "large"
    assert entry.overlap == pytest.approx(1 - 1.2 / 3.2, abs=0.04)


# ---- poses ----


def turned(degrees, direction):
    c2w = np.eye(4)
    c2w[:3, :3] = cv2.Rodrigues(np.array([0, np.radians(degrees), 0]))[0]
    c2w[:3, 3] = direction
    return c2w


def test_an_error_of_pose_is_the_larger_of_two_and_a_direction_counts_both_ways():
    along = np.array([np.cos(np.radians(2)), np.sin(np.radians(2)), 0])
    true = turned(0, [1, 0, 0])
    assert pose_error(turned(3, along), true) == pytest.approx(3)
    assert pose_error(turned(1, 7 * along), true) == pytest.approx(2)
    assert pose_error(turned(1, -along), true) == pytest.approx(2)


def test_area_under_the_curve_of_recall_reckoned_by_hand():
    # (0, 0), (2, 1/2), (8, 1), (10, 1): 0.5 + 4.5 + 2 of 10; up to 5: (0, 0), (2, 1/2), (5, 1/2):
    # 0.5 + 1.5 of 5.
    assert auc([8, 2], 10) == pytest.approx(0.7)
    assert auc([8, 2], 5) == pytest.approx(0.4)
    assert auc([0, 0, 0], 5) == 1 and auc([float("inf")] * 2, 20) == 0
    assert auc([3, float("inf")], 5) == pytest.approx((0.5 * 3 / 2 + 0.5 * 2) / 5)


def test_structure_is_blind_to_brightness_and_contrast_and_sees_a_negative():
    image = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    assert structure_likeness(image, image) == pytest.approx(1, abs=1e-3)
    assert structure_likeness(0.5 * image + 0.2, image) == pytest.approx(1, abs=0.03)
    assert structure_likeness(1 - image, image) == pytest.approx(-1, abs=0.03)


@pytest.mark.parametrize("shade", [0.1, 0.3, 0.7, 0.9])
def test_structure_of_a_plain_image_is_a_number(shade):
    image = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    plain = torch.full_like(image, shade)
    for pair in ((plain, image), (image, plain)):
        assert structure_likeness(*pair).isfinite()


# ---- alignment ----


def cloud():
    """Long Gaussians of several colours at several depths, before a camera at the origin."""
    rng = np.random.default_rng(3)
    count = 60
    aside, z = rng.uniform(-1.2, 1.2, (count, 2)), rng.uniform(2, 5, count)
    scales, quats = rng.uniform(0.05, 0.25, (count, 3)), rng.normal(size=(count, 4))
    colours = rng.uniform(-1, 1, (count, 1, 3))
    parts = (np.column_stack((aside, z)), scales, quats, np.full(count, 0.8), colours)
    return Gaussians(*(torch.tensor(part, dtype=torch.float64)[None] for part in parts))


def predicted(gaussians, rasterizer, unit):
    """A predicted scene whose two cameras stand `unit` apart."""
    pose = np.eye(4)
    pose[0, 3] = unit
    made = SimpleNamespace(gaussians=gaussians)
    parts = {"rasterizer": rasterizer, "predicted_pose": pose}
    return SimpleNamespace(reconstruction=made, **parts)


def looking(c2w, size=32):
    intrinsics = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).double()
    return Cameras(c2w.double()[None, None], intrinsics[None, None], (size, size))


def placed(gaussians, pose):
    rotation = pose[:3, :3]
    means = gaussians.means @ rotation.T + pose[:3, 3]
    quats = matrices_to_quats(rotation @ quats_to_matrices(gaussians.quats))
    return replace(gaussians, means=means, quats=quats)


def test_a_camera_beside_its_place_finds_back_to_what_its_photo_shows():
    # which way the scene lies in the world does not matter
    world = torch.from_numpy(turned(120, [3.0, 1.0, -2.0]))
    scene = placed(cloud(), world).to(torch.float32)
    render = build("rasterizer", "numba")
    true = world @ torch.from_numpy(turned(5, [0.3, 0.1, 0.0]))
    photo = render.render(scene, looking(true).to(torch.float32)).images
    beside = torch.from_numpy(turned(1.5, [0.04, -0.03, 0.02]))
    start = looking(true @ beside).to(torch.float32)
    found = align(predicted(scene, render, unit=1.0), start, photo, F.mse_loss, 60)
    off = torch.linalg.inv(true) @ found.c2w[0, 0].double()
    assert off[:3, 3].norm() < 0.02
    assert torch.rad2deg((off[:3, :3] - torch.eye(3)).norm() / 2**0.5) < 0.4


def test_alignment_is_never_worse_than_where_it_began():
    scene, render = cloud().to(torch.float32), build("rasterizer", "numba")
    photo = render.render(scene, looking(torch.eye(4)).to(torch.float32)).images
    here = looking(torch.from_numpy(turned(0, [0.002, 0, 0]))).to(torch.float32)
    steps_too_large = predicted(scene, render, unit=50.0)
    found = align(steps_too_large, here, photo, F.mse_loss, 2)
    assert torch.equal(found.c2w, here.c2w)


def no_distance(inputs):
    return inputs.rendered.sum() * 0


@pytest.mark.slow
def test_a_pair_with_true_poses_in_another_unit_has_no_error_and_a_camera_said_wrongly_is_put_right(
    folder, wall
):
    scene = photo_scene(folder, (0, 2, 1), 48)
    known, torch_like = wall.Known(folder), build("rasterizer", "numba")
    parts = (known, torch_like, "perceptual", no_distance)
    found = PairProtocol(*parts, steps=2)(scene)
    assert found["pose_error"] < 0.1 and found["psnr"] > 20
    assert found["aligned_psnr"] >= found["psnr"] and found["refined_pose_error"] < 1
    target = scene.target
    wrong = replace(target, c2w=target.c2w @ turned(2, [0, 0, 0]))
    figures = PairProtocol(*parts, steps=25)(replace(scene, targets=(wrong,)))
    assert figures["psnr"] < found["psnr"] - 2
    assert figures["aligned_psnr"] > figures["psnr"] + 2


@pytest.mark.slow
def test_the_command_gives_a_row_to_each_class_and_counts_failures_as_infinite_errors(
    folder, tmp_path, capsys
):
    blank = folder.path.parent / "blank"
    blank.mkdir(exist_ok=True)
    entries = json.loads((folder.path / "cameras.json").read_text())[:3]
    for entry in entries:
        Image.new("RGB", (96, 64), "grey").save(blank / entry["file"])
    (blank / "cameras.json").write_text(json.dumps(entries))
    index = {"wall": {"context": [0, 2], "target": [1], "overlap": 0.7}}
    index["blank"] = {"context": [0, 2], "target": [1], "overlap": 0.2}
    (tmp_path / "index.json").write_text(json.dumps(index))
    out = tmp_path / "out.json"
    options = "--recon classical --size 64 --align 1 --quiet"
    files = f"--index {tmp_path / 'index.json'} --out {out}"
    assert main(f"evaluate {folder.path.parent} {options} {files}".split()) == 0
    shown = capsys.readouterr().out.splitlines()
    lines = {line.split(" | ")[0]: line for line in shown}
    assert lines["| small"].startswith("| small | 1 | 1 | 0.00 / 0.00 / 0.00")
    assert lines["| all pairs"].startswith("| all pairs | 2 | 1 | ")
    assert "perceptual" in lines["| overlap"]
    assert json.loads(out.read_text())[0]["overlap"] == "large"
