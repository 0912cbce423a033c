"""Weights of a backbone and a head, from files of any origin, and which parts they are for.

A file of ours says so in its metadata: `backbone` and `head` are JSON of `PartChoice`, `resolution`
is the side that the network was trained at. NoPoSplat's and MASt3R's checkpoints are recognised by
their layout (`official_checkpoints`).
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from edit3r.contract.errors import InputError, SettingsError, one_line
from edit3r.contract.reporting import say
from edit3r.contract.settings import PartChoice
from edit3r.kit.weights.files import weights_file
from edit3r.kit.weights.find import find
from edit3r_model import OFFICIAL, OFFICIAL_RESOLUTION
from edit3r_model.memory import draw_leaf, leaf_names, release_pages
from edit3r_model.official_checkpoints import (
    DRAWN,
    LICENCES,
    infer_parts,
    is_unused,
    layout_of,
    official_keys,
    read_torch_file,
)

_OF_A_TRAINING = {"optimizer", "average", "step"}  # keys of what `--resume` reads
PARTS = ("backbone", "head")
TOLD = (*PARTS, "resolution", "licence")
"""Metadata of a file, each as JSON."""

SHIPPED = Path(__file__).parent / "weights" / "edit3r-small.safetensors"

SHOWN = 4
"""Keys listed per kind of problem."""


@dataclass(frozen=True)
class LoadedWeights:
    """One file of weights; its tensors stay on disk until they are asked for."""

    path: Path
    source: str  # as the user named it
    kind: str  # "edit3r", "noposplat" or "mast3r"
    tensors: Mapping[str, Tensor]  # on the CPU, in the file's dtype and by its names
    parts: Mapping[str, PartChoice] = field(default_factory=dict)  # {}: it names none
    resolution: int | None = None  # side that the network was trained at [pixels]
    licence: str = "not stated"

    @property
    def drawn(self) -> tuple[str, ...]:
        """Beginnings of the names that such a file lacks by design: drawn at random."""
        return DRAWN.get(self.kind, ())

    def is_drawn(self, name: str) -> bool:
        """Tell whether the file lacks the parameter or layer `name` by design."""
        return f"{name}.".startswith(self.drawn)

    def pieces(self, name: str) -> list[Tensor]:
        """What, joined along the first axis, is our parameter `name`; [] where it is missing."""
        ours = self.kind == "edit3r"
        keys = (name,) if ours else official_keys(name, self.tensors)
        parts = [self.tensors[key] for key in keys if key in self.tensors]
        return parts if len(parts) == len(keys) else []


def load_weights(source: str | Path) -> LoadedWeights:
    """Open a `.ckpt`, `.pth` or `.safetensors` file, or the folder of a training.

    `shipped` are those of this package; `official` are the authors' own, which `edit3r weights get`
    fetches. Raises InputError when the file is none of these or is damaged, MissingDependencyError
    when `official` is not on this machine.
    """
    if str(source) == "official":
        loaded = load_weights(find(OFFICIAL))
        return replace(
            loaded,
            source=f"official ({loaded.source})",
            resolution=OFFICIAL_RESOLUTION,
            licence=OFFICIAL.licence,
        )
    path = SHIPPED if source == "shipped" else weights_file(source)
    if not path.is_file():
        raise InputError(
            f"{source}: no such weights; expected a .ckpt, .pth or .safetensors file, or a folder "
            "of edit3r train."
        )
    if path.suffix != ".safetensors":
        return _official(read_torch_file(path), path, str(source))
    tensors, about = _read_safetensors(path)
    if layout_of(tensors):
        return _official(tensors, path, str(source))
    return LoadedWeights(
        path, str(source), "edit3r", tensors, **_description(about, path)
    )


def _official(content: Mapping[str, object], path: Path, source: str) -> LoadedWeights:
    """A published checkpoint, given as the dictionary that its file holds."""
    tensors = content.get("state_dict", content.get("model", content))
    layout = layout_of(tensors) if isinstance(tensors, Mapping) else None
    if layout is None and content.keys() >= _OF_A_TRAINING:
        raise InputError(
            f"{path}: from where edit3r train goes on; its weights are in {path.parent / 'best'}."
        )
    if layout is None:
        keys = list(tensors)[:3] if isinstance(tensors, Mapping) else ["none"]
        known = ", ".join(map(str, keys))
        raise InputError(
            f"{path}: neither a NoPoSplat checkpoint (keys 'encoder.backbone...') nor a MASt3R one "
            f"(keys 'enc_blocks...'); its first keys: {known}."
        )
    kind, tensors = layout
    parts, licence = infer_parts(tensors, source), LICENCES[kind]
    return LoadedWeights(path, source, kind, tensors, parts, licence=licence)


def _read_safetensors(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    """(tensors, metadata) of a file."""
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise InputError(
            f"{path}: not a readable safetensors file ({error})."
        ) from None


def _description(about: Mapping[str, str], path: Path) -> dict[str, Any]:
    """Parts, resolution and licence, as a file's metadata tell them."""
    if "backbone" not in about:
        return {}
    try:
        described = {
            name: json.loads(text) for name, text in about.items() if name in TOLD
        }
        parts = {name: PartChoice.model_validate(described.pop(name)) for name in PARTS}
    except (ValueError, KeyError) as error:
        raise InputError(
            f"{path}: its metadata do not name the parts it belongs to ({type(error).__name__}: "
            f"{one_line(error)})."
        ) from None
    return {"parts": parts, **described}


def with_parts_of(loaded: LoadedWeights, values: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a reconstructor whose parts are those of the weights.

    What the user set of a part counts over what the file says. Raises SettingsError where the user
    chose another part than the file is for.
    """
    filled = dict(values)
    if loaded.resolution and filled.get("resolution") is None:
        filled["resolution"] = loaded.resolution
    for kind, stored in loaded.parts.items():
        given = filled.get(kind, {})
        if not isinstance(given, Mapping):
            choice = PartChoice.model_validate(given)
            given = {"name": choice.name, **choice.settings}
        name = given.get("name", stored.name)
        if name != stored.name:
            raise SettingsError(
                f"reconstructor.{kind}: {loaded.source} weights are for {stored.name!r}, the "
                f"settings say {name!r}; leave {kind} out, or give weights of {name!r} or "
                "weights=untrained."
            )
        filled[kind] = {"name": name, **stored.settings, **given}
    return filled


def fill(
    network: nn.Module, loaded: LoadedWeights, seed: int = 0
) -> Iterator[tuple[str, nn.Module]]:
    """Give each leaf of a network its weights in float32; yield (name, leaf) before the next.

    The consumer may convert or replace the leaf meanwhile, so that no second copy of the network
    ever exists. Parts that the file lacks by design get initial weights from `seed`. Raises
    InputError for weights that do not fit or are not finite.
    """
    wanted = network.state_dict()
    pieces = {name: loaded.pieces(name) for name in wanted}
    _check_keys(wanted, pieces, loaded)
    # Names, not leaves: a list of leaves would keep replaced ones alive.
    for name in leaf_names(network):
        leaf = network.get_submodule(name)
        if loaded.is_drawn(name):
            draw_leaf(name, leaf, seed)
        else:
            _fill_leaf(name, leaf, pieces, loaded.source)
        yield name, leaf


def _check_keys(
    wanted: Mapping[str, Tensor],
    pieces: Mapping[str, list[Tensor]],
    loaded: LoadedWeights,
) -> None:
    """Raise InputError that names every missing or wrongly shaped key; say what is left over."""
    missing, wrong = [], []
    for name, value in wanted.items():
        if pieces[name]:
            given = _joined([piece.to("meta") for piece in pieces[name]])
            if given.shape != value.shape:
                sizes = f"{list(given.shape)}, expected {list(value.shape)}"
                wrong.append(f"{name} is {sizes}")
        elif not loaded.is_drawn(name):
            missing.append(name)
    read = {id(piece) for problems in pieces.values() for piece in problems}
    left = [key for key, tensor in loaded.tensors.items() if id(tensor) not in read]
    left = [key for key in left if not is_unused(key)]
    problems = {"missing": missing, "wrong shape": wrong, "unexpected": left}
    messages = [f"{len(x)} {what} ({_some(x)})" for what, x in problems.items() if x]
    if missing or wrong:
        raise InputError(
            f"{loaded.source}: these weights do not fit this network: {'; '.join(messages)}. "
            "Set the checkpoint's sizes (--set reconstructor.backbone.KEY=VALUE) or choose "
            "another one."
        )
    if left:
        text = f"{len(left)} tensors of the file have no place in this network: {_some(left)}"
        say("weights_left_over", text)


def _joined(pieces: list[Tensor]) -> Tensor:
    return torch.cat(pieces) if len(pieces) > 1 else pieces[0]


def _some(keys: list[str]) -> str:
    more = f" and {len(keys) - SHOWN} more" if len(keys) > SHOWN else ""
    return ", ".join(keys[:SHOWN]) + more


def _fill_leaf(
    name: str, leaf: nn.Module, pieces: Mapping[str, list[Tensor]], source: str
) -> None:
    for key, old in list(leaf.named_parameters(recurse=False)):
        # A copy of our own in float32, off the file's pages.
        stored = pieces[f"{name}.{key}"]
        value = _joined(stored).to(torch.float32, copy=True)
        for piece in stored:
            release_pages(piece)
        sure = value.sum().isfinite()  # fifty times as fast; a sum may also overflow
        bad = 0 if sure else int((~value.isfinite()).sum())
        if bad:
            raise InputError(
                f"{source}: {name}.{key} holds {bad} values that are not finite."
            )
        setattr(leaf, key, nn.Parameter(value, requires_grad=old.requires_grad))
    for key, buffer in leaf.named_buffers(recurse=False):
        if saved := pieces.get(f"{name}.{key}"):
            buffer.copy_(saved[0])
