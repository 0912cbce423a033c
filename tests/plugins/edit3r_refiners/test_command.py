"""`edit3r simplify`."""

import pytest

from edit3r.cli.main import main
from edit3r.kit.photos.camera_files import posed_cameras, write_cameras
from edit3r.kit.scenes.ply import load_ply, save_ply

from .scenes import textured


@pytest.fixture
def scene_file(tmp_path):
    gaussians, cameras, _ = textured()
    save_ply(tmp_path / "scene.ply", gaussians)
    write_cameras(tmp_path / "cameras.json", posed_cameras(cameras, ["a.png", "b.png"]))
    return tmp_path / "scene.ply"


def test_a_file_becomes_a_smaller_file_of_the_same_views(scene_file, capsys):
    out = scene_file.parent / "small.ply"
    asked = ["--gaussians", "700", "--rasterizer", "numba", "--out", str(out)]
    assert main(["simplify", str(scene_file), *asked]) == 0
    assert 630 <= load_ply(out).count <= 700
    assert load_ply(out).view_index.unique().tolist() == [0, 1]
    assert out.stat().st_size < scene_file.stat().st_size / 3
    assert "6,144 Gaussians -> " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--cameras nowhere.json", "say where to look from with --cameras"),
        ("--gaussians few", "expected auto, all or a number of at least 1, got 'few'."),
        ("--gaussians all", "--gaussians all: nothing to do"),
        ("--set simplify.prices=1", "unknown setting. Did you mean 'price'?"),
        ("--set rasterizer.near_plane=1", "simplify takes only its own settings"),
    ],
)
def test_wrong_use_is_one_sentence(scene_file, capsys, arguments, said):
    out = scene_file.parent / "small.ply"
    assert (
        main(["simplify", str(scene_file), *arguments.split(), "--out", str(out)]) == 2
    )
    assert said in capsys.readouterr().err and not out.exists()
