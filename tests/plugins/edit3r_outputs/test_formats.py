"""Files for other programs: written, opened again by programs that are not ours, and close to the
scene.
"""

import gzip
import json
import shutil
import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import torch

import edit3r
from edit3r.cli.main import main
from edit3r.contract.errors import InputError, MissingDependencyError
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.scenes import reading as read
from edit3r.kit.scenes.ply import load_ply, save_ply
from edit3r.kit.scenes.reading import load_scene

gaussforge = pytest.importorskip("gaussforge", reason="needs the extra export")


def export_scene(path, gaussians, form):
    edit3r.build("writer", form).write(path, SceneToWrite(gaussians))


def file_of(form):
    return edit3r.build("writer", form).offer.component.file_name("s")


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
    from edit3r.kit.geometry.rotations import quats_to_matrices

    turned = quats_to_matrices(gaussians.quats[0]) * gaussians.scales[0][:, None]
    return turned @ turned.transpose(1, 2)


@pytest.mark.parametrize(
    "form", ["spz", "spz4", "sog", "splat", "compressed-ply", "ply"]
)
def test_what_is_written_is_read_again_as_the_same_scene(tmp_path, form):
    made = scene()
    export_scene(tmp_path / file_of(form), made, form)
    read = matched(made, load_scene(tmp_path / file_of(form)))
    torch.testing.assert_close(read.means, made.means, atol=0.004, rtol=0)
    torch.testing.assert_close(read.opacities, made.opacities, atol=0.02, rtol=0)
    torch.testing.assert_close(axes(read), axes(made), atol=1.5e-3, rtol=0.1)
    torch.testing.assert_close(
        read.harmonics[:, :, 0], made.harmonics[:, :, 0], atol=0.06, rtol=0
    )
    if form != "splat":  # which has plain colours only
        error = (read.harmonics - made.harmonics)[:, :, 1:].square().mean().sqrt()
        assert error < 0.03


def with_strays(count):
    """A scene of which three Gaussians lie a hundred times as far as the others."""
    made = scene(count)
    means = made.means.clone()
    means[:, :3] *= 100
    return replace(made, means=means)


def test_strays_cost_a_compressed_ply_the_places_of_few_others(tmp_path):
    made = with_strays(4000)
    export_scene(tmp_path / "s.ply", made, "compressed-ply")
    gaps = torch.cdist(made.means[0, 3:], load_scene(tmp_path / "s.ply").means[0])
    assert (gaps.amin(1) < 0.004).float().mean() > 0.95


def test_a_compressed_ply_that_strays_spoil_is_told_of(tmp_path):
    with pytest.warns(UserWarning, match="of 400 Gaussians are moved by about"):
        export_scene(tmp_path / "s.ply", with_strays(400), "compressed-ply")


def test_spz_is_of_version_3_or_4_as_was_asked_for(tmp_path):
    """Version 3 is one gzip stream; version 4 begins with a plain header."""
    for form in ("spz", "spz4"):
        export_scene(tmp_path / form, scene(), form)
    third = gzip.decompress((tmp_path / "spz").read_bytes())
    fourth = (tmp_path / "spz4").read_bytes()
    assert struct.unpack_from("<4sII", third) == (b"NGSP", 3, 400)
    assert struct.unpack_from("<4sII", fourth) == (b"NGSP", 4, 400)


def splat_transform(*files):
    """PlayCanvas' converter, a program of its own in JavaScript."""
    program = shutil.which("splat-transform")
    if program is None:
        pytest.skip("needs splat-transform: npm install -g @playcanvas/splat-transform")
    command = [program, "-q", "-w", *map(str, files)]
    subprocess.run(command, check=True, capture_output=True, timeout=120)


@pytest.mark.parametrize("form", ["spz", "spz4", "sog", "splat", "compressed-ply"])
def test_splat_transform_reads_every_gaussian_where_it_is(tmp_path, form):
    made, path = scene(), tmp_path / file_of(form)
    export_scene(path, made, form)
    splat_transform(path, tmp_path / "s.csv")
    columns = np.genfromtxt(tmp_path / "s.csv", delimiter=",", names=True)
    theirs = np.stack([columns[axis] for axis in "xyz"], 1)
    gaps = torch.cdist(made.means[0].double(), torch.from_numpy(theirs))
    assert len(theirs) == 400 and gaps.amin(1).max() < 0.004
    opacities = 1 / (1 + np.exp(-columns["opacity"][gaps.argmin(1)]))
    np.testing.assert_allclose(opacities, made.opacities[0].numpy(), atol=0.02)


@pytest.mark.parametrize("form", ["compressed-ply", "ply"])
def test_gsply_reads_it(tmp_path, form):
    gsply = pytest.importorskip("gsply")
    made = scene(degree=0)
    export_scene(tmp_path / file_of(form), made, form)
    theirs = gsply.plyread(str(tmp_path / file_of(form)))
    gaps = torch.cdist(
        made.means[0].double(), torch.as_tensor(np.asarray(theirs.means)).double()
    ).amin(1)
    assert len(theirs.means) == 400 and gaps.max() < 0.004


@pytest.mark.parametrize("form", ["spz", "spz4"])
@pytest.mark.parametrize("degree", [0, 1, 3])
def test_spz_has_y_up_and_z_backward(tmp_path, form, degree):
    """As its format says; gaussforge hands over the numbers of the file as they stand there."""
    made = scene(60, degree)
    export_scene(tmp_path / "s.spz", made, form)
    raw = gaussforge.GaussForge().convert(
        (tmp_path / "s.spz").read_bytes(), "spz", "ply"
    )
    (tmp_path / "raw.ply").write_bytes(raw["data"])
    theirs = load_ply(tmp_path / "raw.ply")
    upright = made.means * torch.tensor(UP_AND_BACK)
    torch.testing.assert_close(theirs.means, upright, atol=3e-4, rtol=0)
    difference = (seen(theirs, UP_AND_BACK) - seen(made)).abs()
    assert difference.max() < 0.07 and difference.mean() < 0.005


def held(name, value, form):
    made = scene(400)
    values = getattr(made, name).clone()
    values[:, :9] = value
    return replace(made, **{name: values}), form


@pytest.mark.parametrize(
    ("made", "form"),
    [
        held("scales", 1e4, "spz"),
        held("scales", 400, "spz"),
        held("scales", 1e4, "spz4"),
        held("scales", 1e9, "compressed-ply"),
        held("harmonics", 1.5, "spz"),
        held("harmonics", -4.0, "spz4"),
        held("harmonics", 5.0, "compressed-ply"),
    ],
)
def test_what_a_format_clips_is_said(tmp_path, made, form):
    with pytest.warns(UserWarning, match="larger than it can store|beyond what it"):
        export_scene(tmp_path / "s", made, form)


@pytest.mark.parametrize(
    "form", ["ply", "spz", "spz4", "sog", "splat", "compressed-ply", "glb"]
)
def test_a_scene_of_nothing_is_one_sentence(tmp_path, form):
    nothing = scene(5).select(torch.zeros(5).bool())
    with pytest.raises(InputError, match="the scene has no Gaussians to write"):
        export_scene(tmp_path / "s", nothing, form)


def glb_columns(path):
    """What the only primitive of a file holds, read by hand: ({name: rows}, the extension)."""
    content = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", content)
    assert (magic, version, length) == (b"glTF", 2, len(content))
    size, kind = struct.unpack_from("<I4s", content, 12)
    tree, start = json.loads(content[20 : 20 + size]), 28 + size
    assert kind == b"JSON" and content[24 + size : start] == b"BIN\0"
    assert size % 4 == 0 and start % 4 == 0
    assert "KHR_gaussian_splatting" in tree["extensionsUsed"]
    (primitive,) = tree["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    columns = {}
    for name, index in primitive["attributes"].items():
        accessor = tree["accessors"][index]
        view = tree["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5121: "u1"}[accessor["componentType"]]
        shape = (accessor["count"], width)
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == np.zeros(shape, kind).nbytes
        values = np.frombuffer(
            content, kind, shape[0] * width, start + view["byteOffset"]
        ).reshape(shape)
        columns[name] = values / 255 if kind == "u1" else values
        if name == "POSITION":
            assert accessor["min"] == pytest.approx(values.min(0).tolist())
            assert accessor["max"] == pytest.approx(values.max(0).tolist())
    return columns, primitive["extensions"]["KHR_gaussian_splatting"]


OWN = "KHR_gaussian_splatting:"
UP_AND_BACK = (1, -1, -1)  # the axes of glTF, seen from ours


def of_glb(columns):
    """The scene that a file's columns mean by the extension."""
    coefficients = [name for name in columns if "SH_DEGREE" in name]
    harmonics = np.stack([columns[name] for name in coefficients], 1)
    values = (
        columns["POSITION"],
        columns[f"{OWN}SCALE"],
        columns[f"{OWN}ROTATION"][:, [3, 0, 1, 2]],
        columns[f"{OWN}OPACITY"][:, 0],
        harmonics,
    )
    return Gaussians(*(torch.tensor(each)[None].float() for each in values))


def seen(gaussians, axes=(1, 1, 1)):
    """The scene from its first camera, in a world with other `axes`."""
    c2w = torch.diag(torch.tensor([*axes, 1.0]))[None, None]
    k = torch.tensor([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])[None, None]
    camera = Cameras(c2w, k, (32, 32))
    return edit3r.build("rasterizer", "torch").render(gaussians, camera).images


def test_glb_follows_the_format_and_the_extension(tmp_path):
    """By glTF 2.0 and KHR_gaussian_splatting, as a turned camera shows: colours too."""
    made = scene(101, degree=3)
    export_scene(tmp_path / "s.glb", made, "glb")
    columns, extension = glb_columns(tmp_path / "s.glb")
    assert extension == {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    positions = made.means[0].numpy() * np.float32(UP_AND_BACK)
    np.testing.assert_array_equal(columns["POSITION"], positions)
    turned = seen(of_glb(columns), UP_AND_BACK)
    torch.testing.assert_close(turned, seen(made), atol=1e-5, rtol=0)


def test_a_glb_has_harmonics_up_to_the_degree_that_the_extension_knows(tmp_path):
    export_scene(tmp_path / "s.glb", scene(4, degree=4), "glb")
    columns, _ = glb_columns(tmp_path / "s.glb")
    assert sum(name.startswith(f"{OWN}SH_DEGREE") for name in columns) == 16


def test_splat_transform_writes_the_same_scene_as_glb(tmp_path):
    """But for its axes, which are y up and z forward, and for `COLOR_0`, which it leaves sRGB."""
    made = scene(50, degree=3)
    save_ply(tmp_path / "s.ply", made)
    export_scene(tmp_path / "ours.glb", made, "glb")
    splat_transform(tmp_path / "s.ply", tmp_path / "theirs.glb")
    ours, extension = glb_columns(tmp_path / "ours.glb")
    theirs, their_extension = glb_columns(tmp_path / "theirs.glb")
    assert set(ours) == set(theirs) and extension.items() <= their_extension.items()
    theirs = seen(of_glb(theirs), (-1, -1, 1))
    ours = seen(of_glb(ours), UP_AND_BACK)
    torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=0)


def test_colours_of_a_glb_are_linear_as_gltf_has_them(tmp_path):
    """Dark and bright values of the standard IEC 61966-2-1, and the opacity beside."""
    srgb = torch.tensor([[0.02, 0.5, 1.0], [1.2, -0.1, 0.04]])
    made = scene(2, degree=0)
    made = replace(made, harmonics=colour_to_dc(srgb)[None, :, None])
    export_scene(tmp_path / "s.glb", made, "glb")
    expected = [[0.00154799, 0.21404114, 1], [1, 0, 0.00309598]]
    colours = glb_columns(tmp_path / "s.glb")[0]["COLOR_0"]
    np.testing.assert_allclose(colours[:, :3], expected, atol=1e-6)
    np.testing.assert_array_equal(colours[:, 3], made.opacities[0].numpy())


def test_without_gaussforge_the_error_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(
        read,
        "_CONVERT",
        f"import sys; sys.modules['gaussforge'] = None\n{read._CONVERT}",
    )
    with pytest.raises(MissingDependencyError, match=r"edit3r\[export\]"):
        export_scene(tmp_path / "s.spz", scene(), "spz")
    assert not list(tmp_path.iterdir())


def test_the_command_writes_beside_the_scene_and_never_over_it(tmp_path, capsys):
    def export(line):
        return main(["export", *line.split()])

    save_ply(tmp_path / "scene.ply", scene())
    content = (tmp_path / "scene.ply").read_bytes()
    assert export(f"{tmp_path} --to spz glb --quiet") == 0
    files = {tmp_path / f"scene.{ending}" for ending in ("ply", "spz", "glb")}
    assert set(tmp_path.iterdir()) == files
    assert capsys.readouterr().out == ""
    assert export(f"{tmp_path} --to spz glb --overwrite") == 0
    told = capsys.readouterr().out
    for file in files - {tmp_path / "scene.ply"}:
        assert f"wrote {file} ({file.stat().st_size / 1e6:.1f} MB)" in told
    assert export(f"{tmp_path} --to spz") == 2
    assert "already exists" in capsys.readouterr().err
    assert export(f"{tmp_path}/scene.ply --to ply --overwrite") == 2
    assert (tmp_path / "scene.ply").read_bytes() == content
    assert export(f"{tmp_path}/scene.spz --to ply --out {tmp_path}/back.ply") == 0
    assert load_ply(tmp_path / "back.ply").count == 400


@pytest.mark.slow
def test_of_a_compressed_ply_both_endings_are_replaced(tmp_path):
    file = tmp_path / "scan.compressed.ply"
    export_scene(file, scene(), "compressed-ply")
    assert main(["export", str(file), "--to", "glb", "--quiet"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == {file.name, "scan.glb"}


def test_the_command_asks_for_one_format_where_one_file_is_named(tmp_path, capsys):
    save_ply(tmp_path / "scene.ply", scene(4, 0))
    line = f"export {tmp_path} --to spz sog --out {tmp_path}/x"
    assert main(line.split()) == 2
    assert "one writer" in capsys.readouterr().err
