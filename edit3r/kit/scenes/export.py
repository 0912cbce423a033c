"""The scene in the formats of other programs, and from them, by gaussforge (extra `export`); GLB is
written here.

gaussforge works in a process of its own: a damaged file can end it, and it prints.
"""

import json
import struct
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from edit3r.contract.errors import InputError, MissingDependencyError, RunError
from edit3r.contract.types import Gaussians
from edit3r.kit.children import PYTHON
from edit3r.kit.compute.colour import srgb_to_linear
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.geometry.harmonics import basis, dc_to_colour
from edit3r.kit.geometry.rotations import normalise_quats
from edit3r.kit.scenes.formats import FORMATS
from edit3r.kit.scenes.ply import SMALLEST_SCALE, VIEWER_DEGREE, load_ply, save_ply

LONGEST = (
    600  # seconds of one conversion: SOG takes half a minute for 380,000 Gaussians
)
_CONVERT = """
import sys, gaussforge
data = open(sys.argv[1], "rb").read()
version = int(sys.argv[5])
answer = gaussforge.GaussForge().convert(data, *sys.argv[3:5], spz_version=version)
if "error" in answer:
    sys.exit(answer["error"])
open(sys.argv[2], "wb").write(answer["data"])
"""


def export_scene(path: str | Path, gaussians: Gaussians, form: str) -> None:
    """Write one scene (batch 1) as one of `FORMATS`, harmonics up to degree 3.

    Raises MissingDependencyError where the format needs gaussforge and it is not installed.
    """
    if form not in FORMATS:
        raise InputError(f"{form!r}: no such format; there are {', '.join(FORMATS)}.")
    if form == "ply":
        save_ply(path, gaussians, degree=VIEWER_DEGREE)
        return
    with atomic_write(path) as partial:
        if form == "glb":
            partial.write_bytes(_glb(gaussians))
            return
        with tempfile.TemporaryDirectory() as scratch:
            plain, made = Path(scratch) / "scene.ply", Path(scratch) / "made"
            save_ply(plain, _for_gaussforge(gaussians, form), degree=VIEWER_DEGREE)
            if form == "spz4":
                _convert(plain, made, "ply", "spz", spz_version=4)
            else:
                _convert(plain, made, "ply", form.replace("-", "."))
            partial.write_bytes(made.read_bytes())


def load_scene(path: str | Path) -> Gaussians:
    """Read a scene of any of `FORMATS` but GLB, told by its suffix. Raises InputError for a file
    that is damaged.
    """
    path = Path(path)
    found = [
        form for form, suffix in FORMATS.items() if path.name.lower().endswith(suffix)
    ]
    if found in ([], ["ply"]):
        return load_ply(path, visible=True)
    if found == ["glb"]:
        raise InputError(
            f"{path}: GLB is written but not read; export from the scene.ply of the run."
        )
    if not path.is_file():
        raise InputError(f"{path}: no such file.")
    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / "scene.ply"
        try:
            _convert(path, plain, found[0].replace("-", "."), "ply")
            return load_ply(plain, visible=True)
        except (RunError, InputError) as error:
            raise InputError(
                f"{path}: cannot be read as {found[0]}; {error}".replace(
                    str(plain), "it"
                )
            ) from None


def _for_gaussforge(gaussians: Gaussians, form: str) -> Gaussians:
    """The scene in the order that makes gaussforge 0.6 write it right.

    It writes the harmonics of a compressed PLY by coefficient; the format (and its own reader) has
    them by colour.
    """
    if form != "compressed-ply":
        return gaussians
    kept = gaussians.harmonics[:, :, : (VIEWER_DEGREE + 1) ** 2]
    by_colour = kept[:, :, 1:].transpose(2, 3).reshape(kept[:, :, 1:].shape)
    return replace(gaussians, harmonics=torch.cat((kept[:, :, :1], by_colour), 2))


def _convert(source: Path, target: Path, *forms: str, spz_version: int = 3) -> None:
    """Let gaussforge turn a file of one format into another."""
    command = [
        *PYTHON,
        "-c",
        _CONVERT,
        str(source),
        str(target),
        *forms,
        str(spz_version),
    ]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=LONGEST
        )
    except subprocess.TimeoutExpired:
        raise RunError(f"gaussforge gave no answer within {LONGEST} seconds.") from None
    reason = done.stderr.strip().splitlines()[-1:] or [
        f"it ended with code {done.returncode}"
    ]
    if "gaussforge" in reason[0] and "ModuleNotFoundError" in reason[0]:
        raise MissingDependencyError(
            f"{' to '.join(forms)} needs gaussforge; pip install 'edit3r[export]'."
        )
    if done.returncode or not target.is_file():
        raise RunError(f"gaussforge: {reason[0][:200]}.")


def _glb(gaussians: Gaussians) -> bytes:
    """Binary glTF 2.0 with the extension KHR_gaussian_splatting; programs without it show coloured
    points.

    All is turned from the frame of view 0 (y down, z forward) to that of glTF (y up, z backward),
    and no node has a rotation, since programs need not apply one to harmonics.
    """
    columns = gaussians.to("cpu")
    turn = torch.tensor([1.0, -1.0, -1.0])
    w, x, y, z = normalise_quats(columns.quats[0]).unbind(-1)
    harmonics = columns.harmonics[0, :, : (VIEWER_DEGREE + 1) ** 2]
    plain = dc_to_colour(harmonics[:, 0]).clamp(0, 1)
    opacities = columns.opacities[0].clamp(0, 1)
    # Each basis function of a turned direction is the same or its negative.
    anywhere = torch.nn.functional.normalize(torch.tensor([0.2, 0.5, 0.8]), dim=0)
    degree = round(harmonics.shape[1] ** 0.5) - 1
    signs = basis(anywhere * turn, degree).sign() * basis(anywhere, degree).sign()
    harmonics = harmonics * signs[:, None]
    own = "KHR_gaussian_splatting"
    attributes = {
        "POSITION": columns.means[0] * turn,
        # linear, as glTF wants it
        "COLOR_0": torch.column_stack((srgb_to_linear(plain), opacities)),
        f"{own}:ROTATION": torch.stack((w, -z, y, -x), -1),  # half a turn first; xyzw
        f"{own}:SCALE": columns.scales[0].clamp(min=SMALLEST_SCALE),
        f"{own}:OPACITY": opacities,
    }
    for index in range(harmonics.shape[1]):
        degree = int(index**0.5)
        name = f"{own}:SH_DEGREE_{degree}_COEF_{index - degree**2}"
        attributes[name] = harmonics[:, index]
    parts = [
        np.ascontiguousarray(values, dtype="<f4") for values in attributes.values()
    ]
    starts = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    accessors = [
        {
            "bufferView": i,
            "componentType": 5126,
            "count": len(p),
            "type": kinds[1 if p.ndim == 1 else p.shape[1]],
        }
        for i, p in enumerate(parts)
    ]
    accessors[0] |= {"min": parts[0].min(0).tolist(), "max": parts[0].max(0).tolist()}
    primitive = {
        "mode": 0,
        "attributes": {name: index for index, name in enumerate(attributes)},
    }
    primitive["extensions"] = {
        own: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    }
    tree = {
        "asset": {"version": "2.0", "generator": "edit3r"},
        "extensionsUsed": [own],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "accessors": accessors,
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": at, "byteLength": p.nbytes}
            for at, p in zip(starts, parts)
        ],
    }
    text = json.dumps(tree, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    data = b"".join(part.tobytes() for part in parts)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON")
        + text
        + struct.pack("<I4s", len(data), b"BIN\0")
        + data
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
