"""`edit3r render`: what it draws of a saved scene."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from edit3r.cli.main import main
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.scenes.ply import save_ply


@pytest.fixture
def scene(tmp_path):
    """Three walls before one camera: red from photo 0, green from photo 1, blue from none."""
    x, y = torch.meshgrid(
        torch.linspace(-1, 1, 20), torch.linspace(-1, 1, 20), indexing="xy"
    )
    wall = torch.stack((x, y, torch.full_like(x, 2.0)), -1).reshape(-1, 3)
    means = torch.cat(
        [wall + torch.tensor([0, 0, 0.1 * number]) for number in range(3)]
    )
    colours = torch.eye(3).repeat_interleave(len(wall), 0)
    count = len(means)
    gaussians = Gaussians(
        means[None],
        torch.full((1, count, 3), 0.08),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.full((1, count), 0.9),
        colour_to_dc(colours)[None, :, None],
        torch.tensor([0, 1, -1]).repeat_interleave(len(wall)),
    )
    save_ply(tmp_path / "scene.ply", gaussians)
    frame = {
        "file_path": "a.png",
        "transform_matrix": np.diag([1.0, -1, -1, 1]).tolist(),
    }
    lens = {"w": 24, "h": 24, "fl_x": 24, "fl_y": 24, "cx": 12, "cy": 12}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": [frame]}))
    return tmp_path


def _render(folder, *options: str, of: str = "scene.ply") -> int:
    cameras = [
        "--cameras",
        str(folder / "transforms.json"),
        "--make",
        "pictures",
        "--out",
        str(folder / "out"),
    ]
    return main(
        [
            "render",
            str(folder / of),
            *cameras,
            "--rasterizer",
            "torch",
            "--quiet",
            *options,
        ]
    )


def test_views_larger_than_wanted_are_drawn_smaller_and_not_all_kept(
    scene, monkeypatch
):
    monkeypatch.setattr("edit3r_outputs.render.MOST_SIDE", 12)
    monkeypatch.setattr("edit3r_outputs.render.MOST_KEPT", 10)
    assert _render(scene) == 0
    (path,) = (scene / "out").rglob("a.png")
    assert Image.open(path).size == (12, 12)
    assert _render(scene, "--size", "24", "--overwrite") == 0
    assert Image.open(path).size == (24, 24)


@pytest.mark.parametrize("count", ["1", "2001"])
def test_a_number_of_frames_that_is_no_flight_is_refused(scene, capsys, count):
    assert _render(scene, "--frames", count) == 2
    assert f"expected 2 to 2000 frames, got {count}" in capsys.readouterr().err
    assert not (scene / "out").exists()


@pytest.mark.parametrize(("view", "colour"), [(0, [1, 0, 0]), (1, [0, 1, 0])])
def test_only_the_gaussians_of_one_photo_are_drawn(scene, view, colour):
    assert _render(scene, "--only-view", str(view)) == 0
    (path,) = (scene / "out").rglob("a.png")
    middle = np.asarray(Image.open(path))[12, 12] / 255
    assert np.abs(middle - colour).max() < 0.1


def test_a_photo_that_gave_no_gaussians_is_an_error_that_lists_those_that_did(
    scene, capsys
):
    assert _render(scene, "--only-view", "2") == 2
    assert "no Gaussians of photo 2; it has 0, 1." in capsys.readouterr().err


def test_the_folder_of_a_run_stands_for_its_scene(scene):
    assert (
        _render(scene, of=".") == 0 and len(list((scene / "out").rglob("a.png"))) == 1
    )
