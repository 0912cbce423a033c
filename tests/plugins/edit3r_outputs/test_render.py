"""`edit3r render`: what it draws of a saved scene."""

import json

import numpy as np
import pytest
from PIL import Image

from edit3r.cli.main import main
from edit3r.kit.scenes.ply import save_ply
from edit3r_testing import gaussian_cloud


@pytest.fixture
def scene(tmp_path):
    """Gaussians before one camera."""
    save_ply(tmp_path / "scene.ply", gaussian_cloud(20))
    frame = {
        "file_path": "a.png",
        "transform_matrix": np.diag([1.0, -1, -1, 1]).tolist(),
    }
    lens = {"w": 24, "h": 24, "fl_x": 24, "fl_y": 24, "cx": 12, "cy": 12}
    (tmp_path / "transforms.json").write_text(json.dumps({**lens, "frames": [frame]}))
    return tmp_path


def _render(folder, *options: str, of: str = "scene.ply") -> int:
    given = f"{folder}/{of} --cameras {folder}/transforms.json --out {folder}/out"
    parts = "--make pictures --rasterizer torch --quiet"
    return main(["render", *given.split(), *parts.split(), *options])


def test_views_larger_than_wanted_are_drawn_smaller(scene, monkeypatch):
    monkeypatch.setattr("edit3r_outputs.render.MOST_SIDE", 12)
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


def test_the_folder_of_a_run_stands_for_its_scene(scene):
    assert (
        _render(scene, of=".") == 0 and len(list((scene / "out").rglob("a.png"))) == 1
    )
