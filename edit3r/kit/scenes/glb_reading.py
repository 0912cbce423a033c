"""Gaussians of binary glTF 2.0 with the extension KHR_gaussian_splatting, by whatever program."""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import warn
from edit3r.contract.types import MAX_DEGREE, Gaussians
from edit3r.kit.compute.colour import linear_to_srgb
from edit3r.kit.files.text import parse_json
from edit3r.kit.geometry.harmonics import colour_to_dc, dc_to_colour
from edit3r.kit.scenes.axes import UP_AND_BACK, flipped, rotated

OWN = "KHR_gaussian_splatting"
# how the names of extensions that hold an SPZ begin
SPZ_INSIDE = f"{OWN}_compression_spz"
_KNOWN = {OWN, "KHR_mesh_quantization"}
FLOAT = 5126  # glTF's number of float32
_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", FLOAT: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
MOST_NODES = 100_000
SIMILAR = 1e-3  # share by which the axes of a node may differ in length, or lean

Columns = dict[str, Float[Tensor, "gaussian width"]]
ReadSpz = Callable[[bytes], Gaussians]
"""The Gaussians of an SPZ, as it stands in the file."""


def load_glb(path: Path, read_spz: ReadSpz) -> Gaussians:
    """All Gaussians of the file's scene, turned to y down and z forward. Raises InputError."""
    try:
        tree, data = _chunks(path.read_bytes())
        _check_extensions(tree)
        parts = list(_parts(tree, data, read_spz))
        if not parts:
            raise ValueError("it has none")
        degree = max(part.degree for part in parts)
        whole = Gaussians.cat([_of_degree(part, degree) for part in parts])
        return flipped(whole, UP_AND_BACK)
    except (
        *(KeyError, IndexError, TypeError, ValueError, AttributeError),
        *(struct.error, RecursionError, RuntimeError, OSError, OverflowError),
    ) as error:
        reason = str(error)
        if not isinstance(error, ValueError):
            reason = f"it is damaged, {type(error).__name__}: {error}"
        raise InputError(
            f"{path}: no Gaussians that can be read as GLB with {OWN} ({reason[:200]})."
        ) from None


def _chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    version, _, length = struct.unpack_from("<III", content, 4)
    if version != 2:
        raise ValueError(f"glTF of version {version}")
    return parse_json(content[20 : 20 + length]), content[28 + length :]


def _check_extensions(tree: dict[str, Any]) -> None:
    """Raise ValueError for what the file says nobody may pass over, and is not known here."""
    for name in tree.get("extensionsRequired", ()):
        if name not in _KNOWN and not str(name).startswith(SPZ_INSIDE):
            raise ValueError(f"it needs {str(name)[:80]}, which is not read")


def _parts(tree: dict[str, Any], data: bytes, read_spz: ReadSpz) -> Iterator[Gaussians]:
    """The Gaussians of each mesh part that has some, where its node places it."""
    most = len(data)  # a Gaussian takes some bytes: fewer are made to fill the memory
    for mesh, place in _placed_meshes(tree):
        for primitive in _entry(tree, "meshes", mesh)["primitives"]:
            extensions = primitive.get("extensions", {})
            inside = {**extensions, **extensions.get(OWN, {}).get("extensions", {})}
            spz = next((name for name in inside if name.startswith(SPZ_INSIDE)), None)
            if spz is not None:
                gaussians = read_spz(_bytes(tree, data, inside[spz]["bufferView"]))
            elif OWN in extensions:
                columns = _columns(tree, data, primitive["attributes"])
                gaussians = _from_columns(columns, extensions[OWN])
            else:
                continue
            most -= gaussians.count
            if most < 0:
                raise ValueError("it promises more Gaussians than it holds")
            yield _through(gaussians, place)


def _placed_meshes(
    tree: dict[str, Any],
) -> Iterator[tuple[int, Float64[np.ndarray, "4 4"]]]:
    """The meshes of the scene, each with its place; without nodes all of them."""
    nodes = tree.get("nodes", [])
    scenes = tree.get("scenes", [])
    if not nodes or not scenes:
        yield from ((index, np.eye(4)) for index in range(len(tree["meshes"])))
        return
    scene = _entry(tree, "scenes", tree.get("scene", 0))
    waiting = [(node, np.eye(4)) for node in scene["nodes"]]
    seen: set[int] = set()
    while waiting:
        index, place = waiting.pop(0)
        if index in seen or len(seen) > MOST_NODES:
            raise ValueError("its nodes form a circle, or are too many")
        seen.add(index)
        node = _entry(tree, "nodes", index)
        place = place @ _matrix(node)
        if "mesh" in node:
            yield node["mesh"], place
        waiting += [(child, place) for child in node.get("children", ())]


def _matrix(node: dict[str, Any]) -> Float64[np.ndarray, "4 4"]:
    if "matrix" in node:
        return np.asarray(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = np.asarray(node.get("rotation", (0, 0, 0, 1)), float)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.asarray(node.get("scale", (1, 1, 1)), float)
    matrix[:3, 3] = np.asarray(node.get("translation", (0, 0, 0)), float)
    return matrix


def _through(gaussians: Gaussians, place: Float64[np.ndarray, "4 4"]) -> Gaussians:
    """The Gaussians moved, turned and made larger as a node says."""
    if (place == np.eye(4)).all():
        return gaussians
    linear = place[:3, :3]
    size = float(np.cbrt(np.linalg.det(linear)))
    if not math.isfinite(size) or size == 0:
        raise ValueError("a node makes its Gaussians infinitely large or small")
    rotation = linear / size  # a mirrored one has a negative size
    if abs(rotation @ rotation.T - np.eye(3)).max() > SIMILAR:
        raise ValueError("a node stretches its Gaussians, which is not read")
    if size < 0:
        gaussians, size = flipped(gaussians, (-1.0, -1.0, -1.0)), -size
    moved = rotated(gaussians, torch.from_numpy(rotation))
    return replace(
        moved,
        means=moved.means * size + torch.from_numpy(place[:3, 3]).to(moved.means),
        scales=moved.scales * size,
    )


def _entry(tree: dict[str, Any], name: str, index: int) -> dict[str, Any]:
    """One of a list by its number, of which Python would count negative ones from the end."""
    if not isinstance(index, int) or index < 0:
        raise ValueError(f"{name} has no number {str(index)[:20]}")
    return tree[name][index]


def _bytes(tree: dict[str, Any], data: bytes, index: int) -> bytes:
    view = _entry(tree, "bufferViews", index)
    buffer = tree["buffers"][view.get("buffer", 0)]
    if view.get("buffer", 0) != 0 or "uri" in buffer:
        raise ValueError("its data lie in another file")
    unknown = [*view.get("extensions", {})]
    if unknown:
        raise ValueError(f"its data are packed by {unknown[0][:80]}, which is not read")
    start, length = view.get("byteOffset", 0), view["byteLength"]
    if not 0 <= start <= start + length <= len(data):
        raise ValueError("it is cut off")
    return data[start : start + length]


def _columns(tree: dict[str, Any], data: bytes, attributes: dict[str, int]) -> Columns:
    """The attributes that Gaussians have, by their names without the extension's."""
    names = [
        "POSITION",
        *(f"{OWN}:{name}" for name in ("ROTATION", "SCALE", "OPACITY")),
    ]
    for degree in range(MAX_DEGREE + 1):
        rows = [f"{OWN}:SH_DEGREE_{degree}_COEF_{i}" for i in range(2 * degree + 1)]
        if rows[0] in attributes:
            names += rows
    columns = {}
    for name in names:
        if name not in attributes:
            raise ValueError(f"it lacks {name}")
        columns[name.rpartition(":")[2]] = _column(tree, data, attributes[name], name)
    return columns


def _column(
    tree: dict[str, Any], data: bytes, index: int, name: str
) -> Float[Tensor, "gaussian width"]:
    accessor = _entry(tree, "accessors", index)
    if "bufferView" not in accessor or "sparse" in accessor:
        raise ValueError(f"{name} is sparse or without data")
    own = _bytes(tree, data, accessor["bufferView"])
    kind = np.dtype(_TYPES[accessor["componentType"]])
    shape = (int(accessor["count"]), _WIDTHS[accessor["type"]])
    tight = kind.itemsize * shape[1]
    view = _entry(tree, "bufferViews", accessor["bufferView"])
    step = view.get("byteStride", tight)
    if step < tight or shape[0] < 0:
        raise ValueError(f"{name} has rows that cover each other")
    start = accessor.get("byteOffset", 0)
    if shape[0] and start + step * (shape[0] - 1) + tight > len(own):
        raise ValueError(f"{name} is cut off")
    strides = (step, kind.itemsize)
    values = np.ndarray(shape, kind, own, start, strides).astype(np.float32)
    if kind.kind != "f" and (accessor.get("normalized") or not name.endswith("SCALE")):
        values /= np.iinfo(kind).max
    return torch.from_numpy(values.clip(min=-1) if kind.kind == "i" else values)


def _from_columns(columns: Columns, extension: dict[str, Any]) -> Gaussians:
    degree = max(int(name[10]) for name in columns if name.startswith("SH_DEGREE_"))
    names = [
        f"SH_DEGREE_{d}_COEF_{i}" for d in range(degree + 1) for i in range(2 * d + 1)
    ]
    harmonics = torch.stack([columns[name] for name in names], 1)
    space = str(extension.get("colorSpace", "srgb_rec709_display"))
    if space == "lin_rec709_display":
        light = dc_to_colour(harmonics[:, :1]).clamp(0, 1)
        harmonics = torch.cat(
            (colour_to_dc(linear_to_srgb(light)), harmonics[:, 1:]), 1
        )
        warn("GLB: its colours are linear; what depends on the direction is not exact.")
    elif space != "srgb_rec709_display":
        warn(f"GLB: colours in {space[:80]!r} are taken as sRGB.")
    kernel = str(extension.get("kernel", "ellipse"))
    if kernel != "ellipse":
        raise ValueError(f"a kernel {kernel[:80]!r}; ellipse is read")
    return Gaussians(
        columns["POSITION"][None],
        columns["SCALE"][None],
        torch.nn.functional.normalize(columns["ROTATION"], dim=-1)[
            None, :, [3, 0, 1, 2]
        ],
        columns["OPACITY"][None, :, 0].clamp(0, 1),
        harmonics[None],
    )


def _of_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    missing = (degree + 1) ** 2 - gaussians.harmonics.shape[2]
    padding = (0, 0, 0, missing)
    return replace(
        gaussians,
        harmonics=torch.nn.functional.pad(gaussians.harmonics, padding),
        view_index=torch.full((gaussians.count,), -1),
    )
