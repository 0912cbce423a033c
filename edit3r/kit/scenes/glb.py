"""Gaussians of binary glTF 2.0 with the extension KHR_gaussian_splatting, as edit3r writes them."""

import json
import struct
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.types import MAX_DEGREE, Gaussians
from edit3r.kit.geometry.harmonics import basis

OWN = "KHR_gaussian_splatting"
FLOAT = 5126  # glTF's number of float32
TURN = torch.tensor([1.0, -1.0, -1.0])
"""From y up and z backward, as glTF has it, to y down and z forward, or back."""
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


def load_glb(path: Path) -> Gaussians:
    """The first Gaussians of the file, turned to y down and z forward. Raises InputError."""
    try:
        return _from_columns(_columns(path.read_bytes()))
    except (
        *(KeyError, IndexError, TypeError, ValueError, AttributeError),
        *(struct.error, RecursionError, RuntimeError, OSError),
    ) as error:
        raise InputError(
            f"{path}: no Gaussians that can be read as GLB with {OWN} "
            f"({type(error).__name__}: {error})."
        ) from None


def turned_signs(degree: int) -> Float[Tensor, "coefficient"]:
    """What harmonics are multiplied by when the scene is turned: each basis function of a turned
    direction is the same or its negative.
    """
    anywhere = torch.nn.functional.normalize(torch.tensor([0.2, 0.5, 0.8]), dim=0)
    return basis(anywhere * TURN, degree).sign() * basis(anywhere, degree).sign()


def _columns(content: bytes) -> dict[str, Float[Tensor, "gaussian width"]]:
    """The attributes of the first primitive with the extension, by their names without it."""
    (length,) = struct.unpack_from("<I", content, 12)
    tree, data = json.loads(content[20 : 20 + length]), content[28 + length :]
    parts = (part for mesh in tree["meshes"] for part in mesh["primitives"])
    primitive = next((one for one in parts if OWN in one.get("extensions", {})), None)
    if primitive is None:
        raise ValueError("it has none")
    columns = {}
    for name, index in primitive["attributes"].items():
        accessor = tree["accessors"][index]
        if accessor["componentType"] != FLOAT:
            raise ValueError(f"{name} is not of float32")
        view = tree["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        width = _WIDTHS[accessor["type"]]
        values = np.frombuffer(data, "<f4", accessor["count"] * width, start)
        own = torch.from_numpy(values.reshape(-1, width).astype(np.float32))
        columns[name.rpartition(":")[2]] = own
    return columns


def _from_columns(columns: dict[str, Float[Tensor, "gaussian width"]]) -> Gaussians:
    degree = max(
        degree
        for degree in range(MAX_DEGREE + 1)
        if f"SH_DEGREE_{degree}_COEF_0" in columns
    )
    names = [
        f"SH_DEGREE_{d}_COEF_{i}" for d in range(degree + 1) for i in range(2 * d + 1)
    ]
    harmonics = torch.stack([columns[name] for name in names], 1)
    x, y, z, w = columns["ROTATION"].unbind(-1)
    quats = torch.stack((x, -w, z, -y), -1)  # half a turn about x first
    gaussians = Gaussians(
        (columns["POSITION"] * TURN)[None],
        columns["SCALE"][None],
        torch.nn.functional.normalize(quats, dim=-1)[None],
        columns["OPACITY"][None, :, 0].clamp(0, 1),
        (harmonics * turned_signs(degree)[:, None])[None],
    )
    if not all(torch.isfinite(one).all() for one in columns.values()):
        raise ValueError("values that are not finite")
    return gaussians
