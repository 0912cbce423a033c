"""GLB of other programs: whatever glTF and KHR_gaussian_splatting allow, or one sentence."""

import json
import struct

import numpy as np
import pytest
import torch

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import SceneToWrite
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Gaussians
from edit3r.kit.scenes.reading import load_scene

P = "KHR_gaussian_splatting:"
KINDS = {"u1": 5121, "i1": 5120, "u2": 5123, "i2": 5122, "f4": 5126}
N = 7
MEANS = np.random.default_rng(0).normal(size=(N, 3)) + np.array([0, 0, -5])


def scaled(values, kind):
    """Values from -1 or 0 to 1 as normalised numbers of glTF."""
    most = np.iinfo(kind).max if kind != "f4" else 1
    values = np.asarray(values) * most
    return (values if kind == "f4" else np.rint(values)).astype(f"<{kind}")


def columns(**more):
    """{name: (rows, whether they are normalised)}"""
    found = {
        "POSITION": MEANS,
        "COLOR_0": np.full((N, 4), 0.6),
        f"{P}ROTATION": np.tile([0, 0.6, 0, 0.8], (N, 1)),
        f"{P}SCALE": np.full((N, 3), 0.25),
        f"{P}OPACITY": np.full((N, 1), 0.9),
        f"{P}SH_DEGREE_0_COEF_0": np.full((N, 3), 0.3),
    }
    found = {name: scaled(rows, "f4") for name, rows in found.items()}
    return {**found, **{name.replace("KHR_", P): rows for name, rows in more.items()}}


def glb(rows, *, node=None, tree=(), stride=0, extension=(), count=None):
    views, accessors, attributes, data = [], [], {}, b""
    for name, own in rows.items():
        attributes[name] = len(accessors)
        width = own.shape[1]
        view = {"buffer": 0, "byteOffset": len(data), "byteLength": 0}
        part = own.tobytes()
        if stride:
            view["byteStride"] = stride
            padding = b"\x55" * (stride - own.itemsize * width)
            part = b"".join(row.tobytes() + padding for row in own)
        view["byteLength"] = len(part)
        views.append(view)
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": KINDS[own.dtype.str[1:]],
                "count": len(own) if count is None else count,
                "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[width],
                "normalized": own.dtype.kind != "f",
            }
        )
        data += part + b"\0" * (-len(part) % 4)
    part = {"mode": 0, "attributes": attributes}
    part["extensions"] = {P[:-1]: {"kernel": "ellipse", **dict(extension)}}
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, **(node or {})}],
        "meshes": [{"primitives": [part]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": views,
        "accessors": accessors,
        **dict(tree),
    }
    return chunks(json.dumps(document).encode(), data)


def chunks(text, data):
    text += b" " * (-len(text) % 4)
    return b"".join(
        (
            struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(data)),
            struct.pack("<I4s", len(text), b"JSON") + text,
            struct.pack("<I4s", len(data), b"BIN\0") + data,
        )
    )


def read(tmp_path, content):
    (tmp_path / "s.glb").write_bytes(content)
    return load_scene(tmp_path / "s.glb")


@pytest.mark.parametrize("width", [3, 4])
@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_the_colours_for_programs_without_the_extension_may_be_of_any_kind(
    tmp_path, kind, width
):
    found = read(tmp_path, glb(columns(COLOR_0=scaled(np.full((N, width), 0.6), kind))))
    upright = torch.tensor(MEANS * (1, -1, -1)).float()[None]
    torch.testing.assert_close(found.means, upright)
    torch.testing.assert_close(found.harmonics, torch.full((1, N, 1, 3), 0.3))
    # turned about y by 73.7 degrees, seen with y down and z forward
    expected = torch.tensor([0.8, 0, -0.6, 0]).expand(1, N, 4)
    torch.testing.assert_close(found.quats, expected)


OTHER_KINDS = {
    "no COLOR_0": {name: rows for name, rows in columns().items() if name != "COLOR_0"},
    "rotations in bytes": columns(
        KHR_ROTATION=scaled(np.tile([0, 0.6, 0, 0.8], (N, 1)), "i1")
    ),
    "rotations in shorts": columns(
        KHR_ROTATION=scaled(np.tile([0, 0.6, 0, 0.8], (N, 1)), "i2")
    ),
    "opacities in bytes": columns(KHR_OPACITY=scaled(np.full((N, 1), 0.9), "u1")),
    "opacities in shorts": columns(KHR_OPACITY=scaled(np.full((N, 1), 0.9), "u2")),
    "sizes in bytes": columns(KHR_SCALE=scaled(np.full((N, 3), 0.25), "u1")),
    "sizes in shorts": columns(KHR_SCALE=scaled(np.full((N, 3), 0.25), "i2")),
}


@pytest.mark.parametrize("rows", OTHER_KINDS.values(), ids=OTHER_KINDS)
def test_numbers_may_be_bytes_and_shorts(tmp_path, rows):
    found, plain = read(tmp_path, glb(rows)), read(tmp_path, glb(columns()))
    for name in ("means", "scales", "quats", "opacities"):
        torch.testing.assert_close(
            getattr(found, name), getattr(plain, name), atol=6e-3, rtol=0
        )


def test_rows_may_lie_apart(tmp_path):
    found = read(tmp_path, glb(columns(), stride=32))
    torch.testing.assert_close(found.means, read(tmp_path, glb(columns())).means)


HALF = 0.5**0.5
NODES = {
    "moved": ({"translation": [1, 2, 3]}, lambda p: p + np.array([1, 2, 3]), 1),
    "larger": ({"scale": [2, 2, 2]}, lambda p: 2 * p, 2),
    "turned": ({"rotation": [0, HALF, 0, HALF]}, lambda p: p[:, [2, 1, 0]] * [1, 1, -1], 1),
    "by matrix": ({"matrix": [3, 0, 0, 0, 0, 3, 0, 0, 0, 0, 3, 0, 1, 0, 0, 1]},
                  lambda p: 3 * p + np.array([1, 0, 0]), 3),
    "mirrored": ({"scale": [-1, -1, -1]}, lambda p: -p, 1),
}  # fmt: skip


@pytest.mark.parametrize(("node", "place", "size"), NODES.values(), ids=NODES)
def test_a_node_places_its_gaussians(tmp_path, node, place, size):
    found = read(tmp_path, glb(columns(), node=node))
    expected = torch.tensor(place(MEANS) * (1, -1, -1)).float()[None]
    torch.testing.assert_close(found.means, expected)
    torch.testing.assert_close(found.scales, torch.full((1, N, 3), 0.25 * size))


def made(count=30):
    generator = torch.Generator().manual_seed(0)
    return Gaussians(
        torch.randn(1, count, 3, generator=generator) + torch.tensor([0, 0, 5.0]),
        torch.full((1, count, 3), 0.1),
        torch.tensor([1.0, 0, 0, 0]).expand(1, count, 4),
        torch.full((1, count), 0.8),
        0.2 * torch.randn(1, count, 4, 3, generator=generator),
    )


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("ending", ["", "_2"])
def test_an_spz_inside_is_read(tmp_path, ending, inside):
    pytest.importorskip("gaussforge", reason="needs the extra export")
    edit3r.build("writer", "spz").write(tmp_path / "s.spz", SceneToWrite(made()))
    packed = (tmp_path / "s.spz").read_bytes()
    name = f"KHR_gaussian_splatting_compression_spz{ending}"
    held = {name: {"bufferView": 0}}
    extensions = {
        P[:-1]: {"extensions": held} if inside else {},
        **({} if inside else held),
    }
    document = {
        "extensionsRequired": [P[:-1], name],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0}, "extensions": extensions}]}
        ],
        "accessors": [{"componentType": 5126, "count": 30, "type": "VEC3"}],
        "buffers": [{"byteLength": len(packed)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(packed)}],
    }
    found = read(tmp_path, chunks(json.dumps(document).encode(), packed))
    torch.testing.assert_close(found.means, made().means, atol=3e-4, rtol=0)
    torch.testing.assert_close(found.harmonics, made().harmonics, atol=0.05, rtol=0)


def changed(name, value):
    rows = columns()[name].copy()
    rows[:3] = value
    return glb(columns(**{name.replace(P, "KHR_"): rows}))


@pytest.mark.parametrize(
    ("name", "value", "told", "left"),
    [
        (f"{P}SCALE", -0.25, "negative sizes", N),
        (f"{P}ROTATION", 0, "3 of 7 Gaussians have a quaternion of only zeros", N - 3),
        (f"{P}ROTATION", np.nan, "3 of 7 Gaussians are not finite", N - 3),
        ("POSITION", np.inf, "3 of 7 Gaussians are not finite", N - 3),
        ("POSITION", 3e38, "3 of 7 Gaussians are not finite", N - 3),
    ],
)
def test_gaussians_that_cannot_be_are_told_of(tmp_path, name, value, told, left):
    with collecting(Report()) as report:
        found = read(tmp_path, changed(name, value))
    assert found.count == left and (found.scales > 0).all()
    assert any(told in warning for warning in report.warnings)


PLAIN = columns()
DEEP = b'{"meshes":' + b"[" * 200_000
BAD = {
    "no Gaussians": (glb({name: rows[:0] for name, rows in PLAIN.items()}), "shows nothing"),
    "all see-through": (glb(columns(KHR_OPACITY=np.zeros((N, 1), "<f4"))), "shows nothing"),
    "no sizes": (glb(columns(KHR_SCALE=np.zeros((N, 3), "<f4"))), "size 0"),
    "counted from the end": (
        glb(PLAIN).replace(b'"bufferView": 0', b'"bufferView":-1'), "no number -1"),
    "no scales": (glb({k: v for k, v in PLAIN.items() if "SCALE" not in k}), "it lacks .*SCALE"),
    "cut off": (glb(PLAIN)[:-200], "cut off"),
    "more than there are": (glb(PLAIN, count=10**9), "cut off"),
    "packed": (glb(PLAIN, tree={"extensionsRequired": ["EXT_meshopt_compression"]}),
               "needs EXT_meshopt_compression, which is not read"),
    "other kernel": (glb(PLAIN, extension={"kernel": "beta"}), "kernel 'beta'"),
    "stretched": (glb(PLAIN, node={"scale": [1, 2, 1]}), "stretches"),
    "round in circles": (glb(PLAIN, node={"children": [0]}), "a circle"),
    "deep": (chunks(DEEP, b""), "nested too deeply"),
    "no SPZ inside": (
        chunks(json.dumps({
            "meshes": [{"primitives": [{"extensions": {
                "KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}}}]}],
            "buffers": [{"byteLength": 40}], "bufferViews": [{"byteLength": 40}],
        }).encode(), bytes(40)), "its SPZ"),
}  # fmt: skip


@pytest.mark.parametrize(("content", "told"), BAD.values(), ids=BAD)
def test_what_cannot_be_read_is_one_sentence(tmp_path, content, told):
    with pytest.raises(InputError, match=rf"s\.glb: .*{told}"):
        read(tmp_path, content)
