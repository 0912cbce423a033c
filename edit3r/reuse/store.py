"""Tensors on disk for the next run: safetensors, each tensor deflated, with version, stage and key in the header.

A tensor is stored as bytes: the first bytes of all numbers, then the second ones, and so on (numbers alike have alike
high bytes), deflated where that is worth the time. Nothing is lost, and nothing is executed when it is read.
"""

import json
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import torch
from safetensors.numpy import save
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.run_folder import atomic_write

FORMAT = "edit3r-reuse"
VERSION = "1"
LEVEL = 1  # higher ones take several times as long for a few percent
PROBE = 1 << 14  # bytes
_DTYPES = {
    str(t).removeprefix("torch."): t for t in (torch.float32, torch.float64, torch.int64, torch.uint8, torch.bool)
}


@dataclass(frozen=True)
class Entry:
    """What one stage answered, or the state of a scene."""

    stage: str
    key: str  # fingerprint of everything it was computed from
    tensors: dict[str, Tensor]
    facts: dict[str, Any] = field(default_factory=dict)  # JSON data


def save_entry(path: Path, entry: Entry) -> None:
    """Write one entry; the same entry gives the same bytes."""
    packed = {name: _packed(tensor) for name, tensor in entry.tensors.items()}
    shapes = {name: [_name(tensor.dtype), list(tensor.shape)] for name, tensor in entry.tensors.items()}
    header = {"version": VERSION, "stage": entry.stage, "key": entry.key, "tensors": shapes, "facts": entry.facts}
    with atomic_write(path) as partial:
        partial.write_bytes(save(packed, {FORMAT: json.dumps(header)}))  # one key: safetensors shuffles several


def read_key(path: Path) -> tuple[str, str]:
    """Stage and key of an entry, from its header alone. Raises InputError for a file that is none."""
    with _opened(path) as file:
        header = _header(file, path)
    return header["stage"], header["key"]


def load_entry(path: Path) -> Entry:
    """Read one entry. Raises InputError for a file that is damaged or of another program or version."""
    with _opened(path) as file:
        header = _header(file, path)
        try:
            shapes = header["tensors"]
            tensors = {name: _unpacked(file.get_tensor(name), *shape) for name, shape in shapes.items()}
            return Entry(header["stage"], header["key"], tensors, header["facts"])
        except (KeyError, TypeError, ValueError, zlib.error, safetensors.SafetensorError) as error:
            raise InputError(f"{path}: damaged ({' '.join(str(error).split())}); {ADVICE}") from None


ADVICE = "start again from the photos, without --from."


def _opened(path: Path):
    try:
        return safetensors.safe_open(path, framework="numpy")
    except (OSError, safetensors.SafetensorError) as error:
        raise InputError(f"{path}: cannot be read ({' '.join(str(error).split())}); {ADVICE}") from None


def _header(file, path: Path) -> dict[str, Any]:
    try:
        header = json.loads((file.metadata() or {})[FORMAT])
        version = header["version"]
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: not written by edit3r for editing again; {ADVICE}") from None
    if version != VERSION:
        raise InputError(f"{path}: written in version {version} of this layout, this edit3r reads {VERSION}; {ADVICE}")
    return header


def _packed(tensor: Tensor) -> np.ndarray:
    values = tensor.detach().cpu().contiguous().numpy()
    planes = values.reshape(-1).view(np.uint8).reshape(values.size, values.itemsize).T
    return np.frombuffer(_deflated(np.ascontiguousarray(planes)), np.uint8)


def _deflated(planes: np.ndarray) -> bytes:
    """One zlib stream (RFC 1950) of all planes; those that hardly shrink are stored, which takes no time."""
    parts = [b"\x78\x01"]
    for plane in planes:
        coder = zlib.compressobj(LEVEL if _shrinks(plane) else 0, wbits=-zlib.MAX_WBITS)
        parts += [coder.compress(plane), coder.flush(zlib.Z_FULL_FLUSH)]
    parts += [zlib.compressobj(wbits=-zlib.MAX_WBITS).flush(), zlib.adler32(planes).to_bytes(4, "big")]
    return b"".join(parts)


def _shrinks(plane: np.ndarray) -> bool:
    """Whether a part from the middle does, by a fifth: noise and photos do not."""
    middle = plane[len(plane) // 2 :][:PROBE]
    return len(zlib.compress(middle, LEVEL)) < 0.8 * len(middle) or len(plane) < PROBE


def _unpacked(packed: np.ndarray, dtype: str, shape: list[int]) -> Tensor:
    like = torch.empty(0, dtype=_DTYPES[dtype])
    if 0 in shape:
        return like.reshape(shape)
    planes = np.frombuffer(zlib.decompress(packed.tobytes()), np.uint8)
    together = np.ascontiguousarray(planes.reshape(like.element_size(), -1).T)
    return torch.from_numpy(together.reshape(-1).copy()).view(like.dtype).reshape(shape)


def _name(dtype: torch.dtype) -> str:
    name = str(dtype).removeprefix("torch.")
    if name not in _DTYPES:
        raise ValueError(f"cannot be stored for editing again: a tensor of {dtype}")
    return name
