"""Official checkpoints: NoPoSplat's Lightning `.ckpt` and MASt3R's `.pth`, read without running any code in them."""

import argparse
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import torch
from torch import Tensor

from edit3r.errors import InputError
from edit3r_model.checkpoints.names import is_unused, official_names, second_name

PREFIX = "encoder."
DRAWN_FROM_MAST3R = ("backbone.intrinsics_embed.", "head.attributes.")
"""What MASt3R does not have: as in the published recipe these parts start from random weights."""


class OfficialState(Mapping[str, Tensor]):
    """Official tensors under our names, joined on request."""

    def __init__(self, tensors: Mapping[str, Tensor], names: list[str]) -> None:
        self.tensors = tensors
        self.names = {ours: found for ours in names if (found := self._find(ours))}

    def _find(self, ours: str) -> tuple[str, ...]:
        keys = tuple(k if k in self.tensors else second_name(k) for k in official_names(ours))
        return keys if all(key in self.tensors for key in keys) else ()

    def __getitem__(self, ours: str) -> Tensor:
        parts = [self.tensors[key] for key in self.names[ours]]
        return parts[0] if len(parts) == 1 else torch.cat(parts)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def unexpected(self) -> tuple[str, ...]:
        """Official keys that nothing of ours reads and that are not known to be unused."""
        read = {key for keys in self.names.values() for key in keys}
        read |= {second_name(key) for key in read}
        return tuple(key for key in self.tensors if key not in read and not is_unused(key))


def read_torch_file(path: Path) -> Mapping[str, object]:
    """The dictionary in a `.ckpt` or `.pth`, tensors left on disk until used; no code in the file is run."""
    mapped = zipfile.is_zipfile(path)
    try:
        # MASt3R keeps its command line as an argparse.Namespace, which holds plain values only.
        with torch.serialization.safe_globals([argparse.Namespace]):
            content = torch.load(path, map_location="cpu", mmap=mapped, weights_only=True)
    except pickle.UnpicklingError as error:
        reason = str(error).split("\n")[0]
        raise InputError(f"{path}: refused, it holds more than tensors and plain values ({reason}).") from None
    except Exception as error:  # a damaged file can make the reader raise almost anything
        raise InputError(f"{path}: not a readable checkpoint ({' '.join(str(error).split())[:200]}).") from None
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: expected a checkpoint dictionary, found {type(content).__name__}.")
    return content


def normalise(content: Mapping[str, object], path: Path) -> tuple[str, dict[str, Tensor]]:
    """(kind, official tensors without prefix) of a checkpoint dictionary; kind is "noposplat" or "mast3r"."""
    tensors = content.get("state_dict", content.get("model", content))
    if not isinstance(tensors, Mapping):
        raise InputError(f"{path}: its 'state_dict' or 'model' is a {type(tensors).__name__}, expected a mapping.")
    tensors = {key: value for key, value in tensors.items() if isinstance(value, Tensor)}
    if any(key.startswith(PREFIX + "backbone.") for key in tensors):
        return "noposplat", {key.removeprefix(PREFIX): value for key, value in tensors.items()}
    if any(key.startswith("backbone.") for key in tensors):
        return "noposplat", tensors
    if any(key.startswith("enc_blocks.") for key in tensors):
        return "mast3r", _from_mast3r(tensors)
    known = ", ".join(list(tensors)[:3]) or "none"
    raise InputError(
        f"{path}: neither a NoPoSplat checkpoint (keys 'encoder.backbone...') nor a MASt3R one (keys "
        f"'enc_blocks...'); its first keys: {known}."
    )


def _from_mast3r(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """MASt3R's keys under NoPoSplat's names; confidence and local features are dropped."""
    result = {}
    for key, value in tensors.items():
        if "head_local_features" in key:
            continue
        if not key.startswith("downstream_head"):
            key = f"backbone.{key}"
        elif ".dpt.head.4." in key:
            value = value[:3]
        result[key] = value
    return result
