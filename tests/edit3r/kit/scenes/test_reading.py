"""Scenes of any program: told by their content, looked at without cameras, or one sentence."""

import gzip
import json
import os
import struct
import zipfile

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.cameras import project
from edit3r.kit.scenes import reading as read
from edit3r.kit.scenes.files import scene_file
from edit3r.kit.scenes.look import SIDES, from_outside, look_at
from edit3r.kit.scenes.reading import load_scene


def scene(count=50, degree=1, **more):
    generator = torch.Generator().manual_seed(0)
    return Gaussians(
        torch.randn(1, count, 3, generator=generator) + torch.tensor([1.0, 2, 5]),
        torch.full((1, count, 3), 0.1),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.full((1, count), 0.9),
        0.1 * torch.randn(1, count, (degree + 1) ** 2, 3, generator=generator),
        **more,
    )


@pytest.mark.parametrize("name", ["renamed.ply", "renamed.spz", "no suffix"])
@pytest.mark.parametrize(
    "form", ["spz", "spz4", "sog", "splat", "compressed-ply", "ply", "glb"]
)
def test_a_format_is_told_by_its_content(tmp_path, form, name):
    pytest.importorskip("gaussforge", reason="needs the extra export")
    made = scene()
    edit3r.build("writer", form).write(tmp_path / name, SceneToWrite(made))
    back = load_scene(tmp_path / name)
    apart = torch.cdist(made.means[0], back.means[0])
    assert back.count == made.count and apart.amin(1).max() < 0.01


def test_a_glb_comes_back_exactly(tmp_path):
    made = scene(degree=3)
    edit3r.build("writer", "glb").write(tmp_path / "s.glb", SceneToWrite(made))
    back = load_scene(tmp_path / "s.glb")
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        torch.testing.assert_close(getattr(back, name), getattr(made, name))


@pytest.mark.parametrize("given", ["folder", "file"])
def test_a_sog_in_loose_files_is_read(tmp_path, given):
    pytest.importorskip("gaussforge", reason="needs the extra export")
    made = scene()
    edit3r.build("writer", "sog").write(tmp_path / "s.sog", SceneToWrite(made))
    with zipfile.ZipFile(tmp_path / "s.sog") as archive:
        archive.extractall(tmp_path / "loose")
    place = scene_file(str(tmp_path / "loose"))
    assert place == tmp_path / "loose/meta.json"
    back = load_scene(place)
    apart = torch.cdist(made.means[0], back.means[0])
    assert back.count == made.count and apart.amin(1).max() < 0.01


@pytest.mark.parametrize(
    ("names", "told"),
    [
        (["a.webp"], "a.webp, which does not lie beside"),
        (["../a"], "no file beside it"),
    ],
)
def test_a_loose_sog_names_files_beside_it(tmp_path, names, told):
    meta = {"version": 2, "means": {"files": names}}
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    (tmp_path.parent / "a").touch()
    with pytest.raises(InputError, match=told):
        load_scene(tmp_path / "meta.json")


def test_a_damaged_file_is_one_sentence_even_where_the_library_dies_of_it(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(read, "_CONVERT", "import os; os.kill(os.getpid(), 11)")
    (tmp_path / "s.sog").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"s\.sog: cannot be read as sog"):
        load_scene(tmp_path / "s.sog")


BAD = {
    "text": (b"hello", "by its content not a PLY"),
    "empty": (b"", "by its content not a PLY"),
    "packed": (gzip.compress(b"ply\n"), "compressed with gzip, but not an SPZ"),
    "glb": (b"glTF" + bytes(40), "no Gaussians that can be read as GLB"),
    "mesh": (
        b"glTF" + struct.pack("<III4s", 2, 34, 13, b"JSON") + b'{"meshes":[]}',
        "it has none",
    ),
    # 200 MB of nothing, packed into 200 kB
    "bomb": (
        gzip.compress(b"NGSP" + struct.pack("<II", 3, 10_000_000) + bytes(99)),
        "promises 10,000,000 Gaussians in",
    ),
}


@pytest.mark.parametrize(("content", "told"), BAD.values(), ids=BAD)
def test_what_is_no_scene_is_one_sentence(tmp_path, content, told):
    (tmp_path / "s.ply").write_bytes(content)
    with pytest.raises(InputError, match=told):
        load_scene(tmp_path / "s.ply")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_what_is_not_there_or_no_file_is_told_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    for name in ("pipe.ply", "none.spz", "."):
        with pytest.raises(InputError, match="no such file"):
            load_scene(tmp_path / name)


# Where a scene lies, and from where it is looked at


@pytest.mark.parametrize(
    "place",
    ["scene.ply", "scene.spz", "point_cloud.ply", "point_cloud/iteration_30000"],
)
def test_a_folder_stands_for_the_scene_in_it(tmp_path, place):
    file = tmp_path / place
    if "iteration" in place:
        file = file / "point_cloud.ply"
        for earlier in ("iteration_7000", "iteration_x"):
            (tmp_path / "point_cloud" / earlier).mkdir(parents=True)
            (tmp_path / "point_cloud" / earlier / "point_cloud.ply").touch()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    assert scene_file(str(tmp_path)) == file


@pytest.mark.parametrize("place", [".", "point_cloud/iteration_30000"])
def test_the_cameras_of_3dgs_are_found(tmp_path, place):
    own = {"id": 0, "img_name": "a", "width": 8, "height": 6, "fx": 9.0, "fy": 9.0}
    own |= {"position": [1, 2, 3], "rotation": np.eye(3).tolist()}
    (tmp_path / "cameras.json").write_text(json.dumps([own]))
    folder = tmp_path / place
    folder.mkdir(parents=True, exist_ok=True)
    with collecting(Report()) as report:
        cameras, posed = look_at(folder / "point_cloud.ply", None, scene())
    assert cameras.c2w[0, 0, :3, 3].tolist() == [1, 2, 3]
    assert posed[0].file == "a" and not report.notes


@pytest.mark.parametrize("beside", ["", "[]", "no json"])
def test_a_scene_without_cameras_is_looked_at_from_outside(tmp_path, beside):
    if beside:
        (tmp_path / "cameras.json").write_text(beside)
    with collecting(Report()) as report:
        cameras, posed = look_at(tmp_path / "s.ply", None, scene())
    assert [camera.file for camera in posed][:2] == ["front.png", "right.png"]
    assert cameras.count == 4 and "from outside" in report.notes["cameras.made_up"]
    assert bool(report.warnings) is bool(beside)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_every_side_sees_the_middle_of_the_scene(unit):
    made = scene(2000)
    means = made.means * unit
    means[0, :40] *= 1000  # what flies about is no reason to step back
    made = Gaussians(means, made.scales, made.quats, made.opacities, made.harmonics)
    cameras = from_outside(made, len(SIDES))
    intrinsics = cameras.intrinsics[0]
    places, depths = project(
        means.expand(len(SIDES), -1, -1), intrinsics, cameras.c2w[0]
    )
    shown = ((places > 0) & (places < 1)).all(-1) & (depths > 0)
    assert (shown.float().mean(1) > 0.85).all()
    # as large as can be: it fills a third of the height, at least
    heights = places[..., 1].quantile(0.9, 1) - places[..., 1].quantile(0.1, 1)
    assert (heights > 0.2).all()
    above = cameras.c2w[0, 4, :3, 3]
    assert above[1] < means[0, :, 1].median() and cameras.c2w[0, 4, 1, 2] > 0.99


# What a format cannot hold


@pytest.mark.parametrize(
    ("form", "degree", "told"),
    [
        ("splat", 3, ["degree 3; it is dropped"]),
        ("spz", 4, ["degree 4; only degree 3"]),
        ("ply", 4, ["degree 4; only degree 3"]),
        ("glb", 4, ["degree 4; only degree 3"]),
        ("compressed-ply", 1, ["objects"]),
        ("spz", 0, ["objects"]),
        ("ply", 3, []),
        ("splat", 0, ["objects"]),
    ],
)
def test_what_an_export_loses_is_said(tmp_path, form, degree, told):
    if form not in ("ply", "glb"):
        pytest.importorskip("gaussforge", reason="needs the extra export")
    objects = torch.zeros(50).long() if told == ["objects"] else None
    made = scene(degree=degree, object_index=objects)
    with collecting(Report()) as report:
        edit3r.build("writer", form).write(tmp_path / "s", SceneToWrite(made))
    assert len(report.warnings) == len(told)
    assert all(one in warning for one, warning in zip(told, report.warnings))
