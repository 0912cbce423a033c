"""Binary glTF, for 3D programs."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import torch

from edit3r.contract.interfaces import SceneToWrite, Writer
from edit3r.contract.types import Gaussians
from edit3r.kit.compute.colour import srgb_to_linear
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r.kit.geometry.rotations import normalise_quats
from edit3r.kit.scenes.axes import UP_AND_BACK, flipped
from edit3r.kit.scenes.glb_reading import FLOAT, OWN
from edit3r.kit.scenes.ply import SMALLEST_SCALE, VIEWER_DEGREE
from edit3r_outputs.formats import tell_of_losses


class GlbWriter(Writer):
    """glTF 2.0 with the extension KHR_gaussian_splatting."""

    def write(self, path: Path, scene: SceneToWrite) -> None:
        tell_of_losses(scene.gaussians, "glb")
        path.write_bytes(_glb(scene.gaussians))


def _glb(gaussians: Gaussians) -> bytes:
    """Binary glTF 2.0 with the extension KHR_gaussian_splatting; programs without it show coloured
    points.

    All is turned from the frame of view 0 (y down, z forward) to that of glTF (y up, z backward),
    and no node has a rotation, since programs need not apply one to harmonics.
    """
    columns = flipped(gaussians.to("cpu"), UP_AND_BACK)
    w, x, y, z = normalise_quats(columns.quats[0]).unbind(-1)
    harmonics = columns.harmonics[0, :, : (VIEWER_DEGREE + 1) ** 2]
    plain = dc_to_colour(harmonics[:, 0]).clamp(0, 1)
    opacities = columns.opacities[0].clamp(0, 1)
    own = OWN
    attributes = {
        "POSITION": columns.means[0],
        # linear, as glTF wants it
        "COLOR_0": torch.column_stack((srgb_to_linear(plain), opacities)),
        f"{own}:ROTATION": torch.stack((x, y, z, w), -1),
        f"{own}:SCALE": columns.scales[0].clamp(min=SMALLEST_SCALE),
        f"{own}:OPACITY": opacities,
    }
    for index in range(harmonics.shape[1]):
        degree = int(index**0.5)
        name = f"{own}:SH_DEGREE_{degree}_COEF_{index - degree**2}"
        attributes[name] = harmonics[:, index]
    parts = [np.ascontiguousarray(one, dtype="<f4") for one in attributes.values()]
    starts = np.cumsum([0, *(part.nbytes for part in parts)]).tolist()
    kinds = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
    accessors: list[dict[str, Any]] = []
    for i, part in enumerate(parts):
        kind = kinds[1 if part.ndim == 1 else part.shape[1]]
        one = {"bufferView": i, "componentType": FLOAT, "count": len(part)}
        accessors.append({**one, "type": kind})
    accessors[0] |= {"min": parts[0].min(0).tolist(), "max": parts[0].max(0).tolist()}
    primitive = {
        "mode": 0,
        "attributes": {name: index for index, name in enumerate(attributes)},
        "extensions": {own: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
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
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
