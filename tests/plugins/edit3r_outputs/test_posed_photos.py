"""A run's cameras for other programs: theirs and ours see every Gaussian at the same pixel."""

import json
import os

import numpy as np
import pycolmap
import pytest
import torch

from edit3r.cli.main import main
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.files.atomic import MARKER
from edit3r.kit.geometry.cameras import project
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.geometry.rotations import quats_to_matrices
from edit3r.kit.photos.camera_files import (
    posed_cameras,
    read_scene_cameras,
    write_cameras,
)
from edit3r.kit.photos.images import load_views, save_image
from edit3r.kit.scenes.ply import load_ply, save_ply

NAMES = ["one photo.png", "two.png"]  # COLMAP's text form would cut a name at its space
SIZE = (48, 64)
PIXEL = 1e-3  # how far programs may disagree on a place


def scene(count=200):
    generator = torch.Generator().manual_seed(1)
    colours = torch.rand(1, count, 1, 3, generator=generator)
    return Gaussians(
        means=torch.randn(1, count, 3, generator=generator) + torch.tensor([0, 0, 6.0]),
        scales=torch.full((1, count, 3), 0.1),
        quats=torch.nn.functional.one_hot(torch.zeros(1, count).long(), 4).float(),
        opacities=torch.full((1, count), 0.9),
        harmonics=colour_to_dc(colours),
    )


@pytest.fixture
def run(tmp_path):
    """The folder of a run with two turned cameras, whose principal points are off the middle."""
    folder = tmp_path / "run"
    c2w = torch.eye(4).repeat(1, 2, 1, 1)
    c2w[0, 1, :3, :3] = quats_to_matrices(torch.tensor([0.9, 0.1, -0.3, 0.2]))
    c2w[0, 1, :3, 3] = torch.tensor([0.5, -0.2, 0.1])
    k = torch.tensor([[1.1, 0, 0.47], [0, 1.4, 0.56], [0, 0, 1]]).repeat(1, 2, 1, 1)
    files = [f"inputs/{name}" for name in NAMES]
    for index, where in enumerate(("inputs", "edited")):
        (folder / where).mkdir(parents=True)
        for name in NAMES:
            save_image(torch.full((3, *SIZE), index * 0.5), folder / where / name)
    save_ply(folder / "scene.ply", scene())
    write_cameras(folder / "cameras.json", posed_cameras(Cameras(c2w, k, SIZE), files))
    return folder


def pixels(cameras):
    """Where our own cameras see the means [pixels], V x G x 2."""
    means = scene().means.double().expand(cameras.count, -1, -1)
    seen, _ = project(means, cameras.intrinsics[0].double(), cameras.c2w[0].double())
    height, width = cameras.image_size
    return (seen * torch.tensor([width, height])).numpy()


def test_colmap_sees_the_gaussians_at_our_pixels(run, tmp_path):
    out = tmp_path / "out"
    assert main(["export", str(run), "--to", "colmap", "--out", str(out)]) == 0
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    ours = pixels(read_scene_cameras(run / "cameras.json")[0])
    theirs = {image.name: image for image in model.images.values()}
    assert sorted(theirs) == NAMES
    means = scene().means[0].double().numpy()
    for name, expected in zip(NAMES, ours):
        for mean, pixel in zip(means, expected):
            found = theirs[name].project_point(mean)
            if found is not None:  # None behind the camera
                np.testing.assert_allclose(found, pixel, atol=PIXEL)
        in_front = [theirs[name].project_point(mean) is not None for mean in means]
        assert sum(in_front) > 100
    points = [model.points3D[index + 1] for index in range(len(means))]
    np.testing.assert_allclose([point.xyz for point in points], means, atol=1e-6)
    colours = (scene().harmonics[0, :, 0] * 0.28209479 + 0.5) * 255
    np.testing.assert_allclose([p.color for p in points], colours.numpy(), atol=0.51)


def test_transforms_are_read_as_the_cameras_they_were_written_from(run, tmp_path):
    out = tmp_path / "out"
    assert main(["export", str(run), "--to", "nerfstudio", "--out", str(out)]) == 0
    read, views = read_scene_cameras(out / "transforms.json")
    ours = pixels(read_scene_cameras(run / "cameras.json")[0])
    np.testing.assert_allclose(pixels(read), ours, atol=PIXEL)
    assert [view.file for view in views] == [f"images/{name}" for name in NAMES]
    points = json.loads((out / "transforms.json").read_text())["ply_file_path"]
    header, _, body = (out / points).read_bytes().partition(b"end_header\n")
    ours = load_ply(run / "scene.ply")
    assert b"element vertex %d\n" % ours.count in header
    rows = np.frombuffer(body, [("position", "<f4", 3), ("colour", "u1", 3)])
    np.testing.assert_allclose(rows["position"], ours.means[0], atol=1e-6)


@pytest.mark.parametrize("form", ["colmap", "nerfstudio"])
def test_what_is_exported_is_read_back_with_the_same_poses(run, tmp_path, form):
    out = tmp_path / "out"
    assert main(["export", str(run), "--to", form, "--out", str(out)]) == 0
    ours, _ = read_scene_cameras(run / "cameras.json")
    views = load_views(out, size=None)  # finds the cameras beside the images
    np.testing.assert_allclose(views.c2w.numpy(), ours.c2w.numpy(), atol=1e-6)
    np.testing.assert_allclose(views.intrinsics, ours.intrinsics, atol=1e-6)


@pytest.mark.parametrize("form", ["colmap", "nerfstudio"])
def test_the_images_are_the_edited_ones_or_else_the_photos(run, tmp_path, form):
    (run / "edited" / "two.png").unlink()
    assert main(["export", str(run), "--to", form]) == 0
    images = run / f"scene-{form}" / "images"
    first, second = [(images / name).read_bytes() for name in NAMES]
    assert first == (run / "edited" / NAMES[0]).read_bytes()
    assert second == (run / "inputs" / NAMES[1]).read_bytes()


def test_views_without_a_pose_are_named_and_left_out(run, capsys):
    cameras = json.loads((run / "cameras.json").read_text())
    cameras[1]["c2w"] = None
    (run / "cameras.json").write_text(json.dumps(cameras))
    assert main(["export", str(run), "--to", "nerfstudio"]) == 0
    assert "two.png: without a pose" in capsys.readouterr().err
    assert len(list((run / "scene-nerfstudio" / "images").iterdir())) == 1


@pytest.mark.parametrize(
    ("gone", "told"),
    [("cameras.json", "holds no cameras.json"), ("inputs/two.png", "no image two.png")],
)
def test_what_the_run_lacks_is_one_sentence(run, tmp_path, capsys, gone, told):
    (run / "edited" / "two.png").unlink()
    (run / gone).unlink()
    out = tmp_path / "out"
    assert main(["export", str(run), "--to", "colmap", "--out", str(out)]) == 2
    assert told in capsys.readouterr().err and not out.exists()
    assert not list(tmp_path.glob(".out*"))


def test_a_folder_of_others_is_never_replaced(run, tmp_path, capsys):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    command = ["export", str(run), "--to", "colmap", "--out", str(tmp_path / "out")]
    assert main(command) == 2 and "already exists" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 2
    assert (tmp_path / "out" / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("content", [b"a secret", b"%!PS-Adobe-3.0 EPSF-3.0\n"])
def test_only_images_are_copied_out_of_a_strangers_folder(run, tmp_path, content):
    (tmp_path / "key").write_bytes(content)
    (run / "edited" / "two.png").unlink()
    (run / "edited" / "two.png").symlink_to(tmp_path / "key")
    assert main(["export", str(run), "--to", "nerfstudio"]) == 2
    assert not (run / "scene-nerfstudio").exists()


def test_images_of_another_size_than_the_cameras_are_refused(run, capsys):
    save_image(torch.zeros(3, 5, 5), run / "edited" / "two.png")
    assert main(["export", str(run), "--to", "colmap"]) == 2
    assert "two.png: has another size" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["one photo.png", os.fsdecode(b"\x80\x1b[0m.png")])
def test_names_of_images_are_safe_and_no_two_alike(run, name):
    cameras = json.loads((run / "cameras.json").read_text())
    cameras[1]["file"] = name
    (run / "cameras.json").write_text(json.dumps(cameras))
    save_image(torch.zeros(3, *SIZE), run / "edited" / name)
    assert main(["export", str(run), "--to", "colmap"]) == 0
    out = run / "scene-colmap"
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    names = sorted(image.name for image in model.images.values())
    assert names == sorted(os.listdir(out / "images")) and len(names) == 2
    assert all(name.isprintable() for name in names)


def test_the_run_that_is_read_is_not_replaced_by_its_cameras(run, capsys):
    (run / MARKER).write_text("{}")
    command = ["export", str(run), "--to", "colmap", "--out", str(run), "--overwrite"]
    assert (
        main(command) == 2
        and "would overwrite a file that is read" in capsys.readouterr().err
    )
    assert (run / "scene.ply").is_file()
