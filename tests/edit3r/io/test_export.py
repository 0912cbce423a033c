"""Files for other programs: written, opened again by programs that are not ours, and close to the
scene.
"""

import struct

import numpy as np
import pytest
import torch

from edit3r.cli.main import main
from edit3r.contract.types import Gaussians
from edit3r.errors import InputError, MissingDependencyError
from edit3r.geometry.harmonics import colour_to_dc
from edit3r.io import export
from edit3r.io.export import FORMATS, export_scene, load_scene
from edit3r.io.ply import load_ply, save_ply

gaussforge = pytest.importorskip("gaussforge", reason="needs the extra export")


def scene(count=400, degree=1):
    generator = torch.Generator().manual_seed(0)
    plain = colour_to_dc(torch.rand(1, count, 1, 3, generator=generator))
    rest = 0.1 * torch.randn(1, count, (degree + 1) ** 2 - 1, 3, generator=generator)
    return Gaussians(
        means=torch.randn(1, count, 3, generator=generator) + torch.tensor([0, 0, 5.0]),
        scales=0.02 + 0.1 * torch.rand(1, count, 3, generator=generator),
        quats=torch.nn.functional.normalize(
            torch.randn(1, count, 4, generator=generator), dim=-1
        ),
        opacities=torch.rand(1, count, generator=generator) * 0.8 + 0.1,
        harmonics=torch.cat((plain, rest), 2),
    )


def matched(made, read):
    """The read Gaussians in the order of the made ones, by nearest centre."""
    nearest = torch.cdist(made.means[0].double(), read.means[0].double()).argmin(1)
    assert len(nearest.unique()) == made.count
    return read.select(nearest)


def axes(gaussians):
    """Covariances, which do not depend on how axes are named or turned."""
    from edit3r.geometry.rotations import quats_to_matrices

    turned = quats_to_matrices(gaussians.quats[0]) * gaussians.scales[0][:, None]
    return turned @ turned.transpose(1, 2)


@pytest.mark.parametrize("form", ["spz", "sog", "splat", "compressed-ply", "ply"])
def test_what_is_written_is_read_again_as_the_same_scene(tmp_path, form):
    made = scene()
    export_scene(tmp_path / f"s{FORMATS[form]}", made, form)
    read = matched(made, load_scene(tmp_path / f"s{FORMATS[form]}"))
    torch.testing.assert_close(read.means, made.means, atol=0.004, rtol=0)
    torch.testing.assert_close(read.opacities, made.opacities, atol=0.02, rtol=0)
    torch.testing.assert_close(axes(read), axes(made), atol=1.5e-3, rtol=0.1)
    torch.testing.assert_close(
        read.harmonics[:, :, 0], made.harmonics[:, :, 0], atol=0.06, rtol=0
    )
    if form != "splat":  # which has plain colours only
        error = (read.harmonics - made.harmonics)[:, :, 1:].square().mean().sqrt()
        assert error < 0.03


@pytest.mark.parametrize(
    ("form", "theirs"),
    [("spz", "spz"), ("compressed-ply", "compressed.ply"), ("ply", "ply")],
)
def test_gaussforge_counts_every_gaussian(tmp_path, form, theirs):
    export_scene(tmp_path / "s", scene(), form)
    found = gaussforge.GaussForge().read((tmp_path / "s").read_bytes(), theirs)
    assert found["data"]["numPoints"] == 400


@pytest.mark.parametrize("form", ["compressed-ply", "ply"])
def test_gsply_reads_it(tmp_path, form):
    gsply = pytest.importorskip("gsply")
    made = scene(degree=0)
    export_scene(tmp_path / f"s{FORMATS[form]}", made, form)
    theirs = gsply.plyread(str(tmp_path / f"s{FORMATS[form]}"))
    gaps = torch.cdist(
        made.means[0].double(), torch.as_tensor(np.asarray(theirs.means)).double()
    ).amin(1)
    assert len(theirs.means) == 400 and gaps.max() < 0.004


def test_glb_follows_the_format_and_the_extension(tmp_path):
    """By glTF 2.0 and KHR_gaussian_splatting, read by hand: exact, aligned, with the bounds that
    glTF asks for.
    """
    import json

    made = scene(101, degree=4)
    export_scene(tmp_path / "s.glb", made, "glb")
    content = (tmp_path / "s.glb").read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    tree, start = json.loads(content[20 : 20 + size]), 28 + size
    assert (
        kind == b"JSON"
        and content[24 + size : start] == b"BIN\0"
        and size % 4 == 0
        and start % 4 == 0
    )
    primitive = tree["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0 and "KHR_gaussian_splatting" in tree["extensionsUsed"]
    assert primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"
    columns = {}
    for name, index in primitive["attributes"].items():
        accessor = tree["accessors"][index]
        view = tree["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert (
            view["byteOffset"] % 4 == 0
            and view["byteLength"] == 4 * width * accessor["count"] == 4 * width * 101
        )
        columns[name.rpartition(":")[2]] = np.frombuffer(
            content, "<f4", width * 101, start + view["byteOffset"]
        )
    assert sum(name.startswith("SH_DEGREE") for name in columns) == 16, (
        "degree 3 is the highest the extension knows"
    )
    np.testing.assert_array_equal(
        columns["POSITION"].reshape(-1, 3), made.means[0].numpy()
    )
    np.testing.assert_array_equal(
        columns["SH_DEGREE_3_COEF_6"].reshape(-1, 3), made.harmonics[0, :, 15].numpy()
    )
    np.testing.assert_allclose(
        columns["ROTATION"].reshape(-1, 4)[:, [3, 0, 1, 2]],
        made.quats[0].numpy(),
        atol=1e-6,
    )
    assert tree["accessors"][0]["max"] == pytest.approx(made.means[0].amax(0).tolist())


def test_a_damaged_file_is_one_sentence_even_where_the_library_dies_of_it(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(export, "_CONVERT", "import os; os.kill(os.getpid(), 11)")
    (tmp_path / "s.sog").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"s\.sog: cannot be read as sog"):
        load_scene(tmp_path / "s.sog")


def test_without_gaussforge_the_error_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(
        export,
        "_CONVERT",
        f"import sys; sys.modules['gaussforge'] = None\n{export._CONVERT}",
    )
    with pytest.raises(MissingDependencyError, match=r"edit3r\[export\]"):
        export_scene(tmp_path / "s.spz", scene(), "spz")
    assert not list(tmp_path.iterdir())


def test_the_command_writes_beside_the_scene_and_never_over_it(tmp_path, capsys):
    save_ply(tmp_path / "scene.ply", scene())
    content = (tmp_path / "scene.ply").read_bytes()
    assert main(["export", str(tmp_path), "--to", "spz", "glb", "--quiet"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        "scene.ply",
        "scene.spz",
        "scene.glb",
    }
    assert (
        main(["export", str(tmp_path), "--to", "spz"]) == 2
        and "already there" in capsys.readouterr().err
    )
    assert (
        main(["export", str(tmp_path / "scene.ply"), "--to", "ply", "--overwrite"]) == 2
    )
    assert (tmp_path / "scene.ply").read_bytes() == content
    assert (
        main(
            [
                "export",
                str(tmp_path / "scene.spz"),
                "--to",
                "ply",
                "--out",
                str(tmp_path / "back.ply"),
            ]
        )
        == 0
    )
    assert load_ply(tmp_path / "back.ply").count == 400


def test_the_command_asks_for_one_format_where_one_file_is_named(tmp_path, capsys):
    save_ply(tmp_path / "scene.ply", scene(4, 0))
    assert (
        main(
            [
                "export",
                str(tmp_path),
                "--to",
                "spz",
                "sog",
                "--out",
                str(tmp_path / "x"),
            ]
        )
        == 2
    )
    assert "one format" in capsys.readouterr().err
