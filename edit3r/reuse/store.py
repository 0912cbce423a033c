"""Tensors on disk for the next run: safetensors, with version, stage, key and a hash of the content in the header.

Nothing is executed when it is read. Nothing is packed either: that would halve the files, and takes a third of the time
of all that a run writes.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import safetensors
import torch
from safetensors.numpy import save
from torch import Tensor

from edit3r.errors import InputError
from edit3r.io.atomic import atomic_write
from edit3r.reuse.fingerprint import fingerprint

FORMAT = "edit3r-reuse"
VERSION = "2"
_DTYPES = (torch.float32, torch.float64, torch.int64, torch.uint8, torch.bool)


@dataclass(frozen=True)
class Entry:
    """What one stage answered, or the state of a scene."""

    stage: str
    key: str  # fingerprint of everything it was computed from; empty for a scene
    tensors: dict[str, Tensor]
    facts: dict[str, Any] = field(default_factory=dict)  # JSON data


def save_entry(path: Path, entry: Entry) -> None:
    """Write one entry; the same entry gives the same bytes."""
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in entry.tensors.items()}
    unknown = [str(tensor.dtype) for tensor in tensors.values() if tensor.dtype not in _DTYPES]
    if unknown:
        raise ValueError(f"cannot be stored for editing again: a tensor of {unknown[0]}")
    header = {"version": VERSION, "stage": entry.stage, "key": entry.key, "facts": entry.facts}
    metadata = json.dumps({**header, "content": _content(tensors, entry.facts)})
    with atomic_write(path) as partial:  # one key: safetensors shuffles several
        partial.write_bytes(save({name: tensor.numpy() for name, tensor in tensors.items()}, {FORMAT: metadata}))


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
            tensors = {name: torch.from_numpy(file.get_tensor(name)) for name in file.keys()}  # noqa: SIM118
            entry, content = Entry(header["stage"], header["key"], tensors, header["facts"]), header["content"]
        except (KeyError, TypeError, ValueError, safetensors.SafetensorError) as error:
            raise InputError(f"{path}: damaged ({' '.join(str(error).split())}); {ADVICE}") from None
    if _content(tensors, entry.facts) != content:
        raise InputError(f"{path}: damaged, its content is not what was written; {ADVICE}")
    return entry


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


def _content(tensors: dict[str, Tensor], facts: dict[str, Any]) -> str:
    return fingerprint([[name, tensors[name]] for name in sorted(tensors)], json.dumps(facts))
