"""Weights of the full network from and to files: our own format, official checkpoints, MASt3R, and
hub ids.

Our format is a folder with `model.safetensors` (our parameter names) and `config.json` (what to
build). A file that `edit3r train` wrote holds the configuration itself.
"""

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from edit3r.errors import InputError, MissingDependencyError
from edit3r.io.atomic import atomic_write
from edit3r.io.fetching import sha256_of
from edit3r.io.weight_files import WEIGHTS as TRAINED
from edit3r.plugins.weights import find
from edit3r_model import OFFICIAL, OFFICIAL_RESOLUTION
from edit3r_model.full_network import NetworkConfig, empty_network
from edit3r_model.memory import draw_leaf, leaf_names, release_pages
from edit3r_model.official_checkpoints import LICENCES, read_official, read_torch_file

WEIGHTS, CONFIG = "model.safetensors", "config.json"
EXTRA_STATE = (
    "_extra_state"  # torch's key for what `GaussianNetwork.get_extra_state` gives
)
FORMAT = 1
SHOWN = 4
"""Keys listed per kind of problem."""

_HUB_ID = re.compile(
    r"(?P<repo>[\w.-]+/[\w.-]+)(?:@(?P<revision>[\w./-]+?))?(?::(?P<file>[\w./-]+))?"
)


@dataclass(frozen=True)
class LoadedWeights:
    """One weight file, its tensors by our names (`backbone.*`, `head.*`), read only when asked
    for.
    """

    config: NetworkConfig
    state: Mapping[str, Tensor]  # on the CPU, in the file's dtype
    source: str  # path, or hub id with revision
    kind: str  # "noposplat", "mast3r" or "edit3r"
    sha256: str  # of the file that holds the tensors
    licence: str  # what is known about using these weights
    drawn: tuple[
        str, ...
    ] = ()  # prefixes that the file is known not to hold: they are drawn at random
    unexpected: tuple[
        str, ...
    ] = ()  # keys in the file that the network has no place for

    def facts(self) -> dict[str, str]:
        """Return what a run's manifest says of the weights."""
        return {
            "source": self.source,
            "kind": self.kind,
            "sha256": self.sha256,
            "licence": self.licence,
        }

    def is_drawn(self, name: str) -> bool:
        """Tell whether the file is known not to hold the parameter or layer `name`."""
        return f"{name}.".startswith(self.drawn)


def load_weights(source: str | Path) -> LoadedWeights:
    """Open a Lightning `.ckpt`, a MASt3R `.pth`, a `.safetensors` file, our folder, or a hub id
    `owner/name@revision`.

    `official` are the authors' own, which `edit3r weights get` fetches. Tensors stay on disk until
    used. Raises InputError when the file is none of these or is damaged, MissingDependencyError
    when `official` is not at hand.
    """
    if str(source) == "official":
        loaded = load_weights(find(OFFICIAL))
        config = replace(loaded.config, resolution=OFFICIAL_RESOLUTION)
        return replace(
            loaded,
            config=config,
            source=f"official ({loaded.source})",
            licence=OFFICIAL.licence,
        )
    path = _download(str(source)) if is_hub_id(str(source)) else Path(source)
    if path.is_dir():
        path = path / (
            TRAINED
            if (path / TRAINED).is_file() and not (path / WEIGHTS).is_file()
            else WEIGHTS
        )
    if not path.is_file():
        raise InputError(
            f"{source}: no such weights; expected a .ckpt, .pth or .safetensors file, a folder "
            f"with {WEIGHTS} "
            f"and {CONFIG}, or a hub id owner/name@revision."
        )
    if path.suffix != ".safetensors":
        return _official(read_torch_file(path), path, str(source))
    tensors = _read_safetensors(path)
    embedded = tensors.pop(EXTRA_STATE, None)
    described = path.parent / CONFIG
    if described.is_file():
        config, licence = _parse_config(described.read_bytes(), described)
    elif embedded is not None:
        config, licence = _parse_config(bytes(embedded.tolist()), path)
    else:
        return _official(tensors, path, str(source))
    return LoadedWeights(
        config, tensors, str(source), "edit3r", sha256_of(path), licence
    )


def are_of_the_full_network(source: str) -> bool:
    """Tell whether `source` names weights that `load_weights` reads, rather than those of the small
    network.
    """
    path = Path(source)
    if source == "official" or path.suffix in (".ckpt", ".pth") or is_hub_id(source):
        return True
    if path.is_dir():
        path = next(
            (path / name for name in (WEIGHTS, TRAINED) if (path / name).is_file()),
            path,
        )
    return path.is_file() and (
        (path.parent / CONFIG).is_file() or EXTRA_STATE in _read_safetensors(path)
    )


def save_weights(
    folder: str | Path,
    state: Mapping[str, Tensor],
    config: NetworkConfig,
    licence: str,
    provenance: Mapping[str, Any],
) -> None:
    """Write `state` and what is needed to rebuild its network into `folder`; each file appears only
    when whole.

    `provenance` is any JSON data worth keeping: the file converted from and its hash, training
    data, steps.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    about = {
        "format": FORMAT,
        **asdict(config),
        "licence": licence,
        "provenance": dict(provenance),
    }
    with (
        atomic_write(folder / CONFIG) as described,
        atomic_write(folder / WEIGHTS) as partial,
    ):
        described.write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
        save_file(
            {name: tensor.contiguous() for name, tensor in state.items()},
            partial,
            {"format": "pt"},
        )
        partial.chmod(
            described.stat().st_mode
        )  # safetensors makes files that only their owner can read


def fill(
    network: nn.Module, loaded: LoadedWeights, seed: int = 0
) -> Iterator[tuple[str, nn.Module]]:
    """Give each leaf of an empty `network` its weights in float32 and yield (name, leaf) before
    touching the next.

    The consumer may convert or replace the leaf meanwhile, so that no second copy of the network
    ever exists. Parts that `loaded` declares as drawn get initial weights from `seed`. Raises
    InputError for weights that do not fit or are not finite.
    """
    _check_keys(network, loaded)
    for name in leaf_names(
        network
    ):  # names, not leaves: a list of leaves would keep replaced ones alive
        leaf = network.get_submodule(name)
        if loaded.is_drawn(name):
            draw_leaf(name, leaf, seed)
        else:
            _fill_leaf(name, leaf, loaded)
        yield name, leaf


def convert(
    source: str,
    out: Path,
    dtype: str = "float32",
    resolution: int | None = None,
    heads: Mapping[str, int | None] | None = None,
    licence: str | None = None,
    seed: int = 0,
) -> str:
    """Read `source`, check every key, write it to folder `out` in our format; returns a sentence
    for the user.

    The other arguments are what a checkpoint does not say itself, `heads` the settings `heads` and
    `decoder_heads` of the backbone. Parts that the file lacks by design (MASt3R has no attribute
    head) are drawn from `seed`.
    """
    loaded = load_weights(source)
    if Path(source).resolve() in (out.resolve(), (out / WEIGHTS).resolve()):
        raise InputError(
            f"{out}: source and target are the same; choose another folder."
        )
    config = _complete_config(loaded, heads or {}, resolution)
    state = _converted_state(loaded, config, getattr(torch, dtype), seed)
    provenance = {
        "converted_from": Path(source).name,
        "sha256": loaded.sha256,
        "kind": loaded.kind,
    }
    if loaded.drawn:
        provenance["drawn_at_random"] = list(loaded.drawn)
    save_weights(out, state, config, licence or loaded.licence, provenance)
    parameters = sum(value.numel() for value in state.values())
    drawn = (
        f" {', '.join(loaded.drawn)} are random: train before use."
        if loaded.drawn
        else ""
    )
    return f"{out}: {WEIGHTS} with {parameters:,} parameters in {dtype}, {CONFIG} beside it.{drawn}"


def is_hub_id(source: str) -> bool:
    """Tell whether `source` has the form owner/name..., unless a file or folder of that name
    exists.
    """
    found = _HUB_ID.fullmatch(source)
    looks_local = Path(source).exists() or Path(source).suffix in (
        ".ckpt",
        ".pth",
        ".pt",
        ".safetensors",
    )
    return found is not None and not (looks_local and "@" not in source)


def _official(content: Mapping[str, object], path: Path, source: str) -> LoadedWeights:
    kind, config, state = read_official(content, path, source)
    return LoadedWeights(
        config,
        state,
        source,
        kind,
        sha256_of(path),
        LICENCES[kind],
        drawn=state.drawn,
        unexpected=state.unexpected(),
    )


def _complete_config(
    loaded: LoadedWeights, heads: Mapping[str, int | None], resolution: int | None
) -> NetworkConfig:
    """The file's sizes with what the user adds, spelled out in full."""
    settings = loaded.config.backbone.settings | {
        name: value for name, value in heads.items() if value is not None
    }
    if loaded.kind != "edit3r":
        backbone = empty_network(loaded.config, **settings).backbone
        settings |= {"heads": backbone.heads, "decoder_heads": backbone.decoder_heads}
    sized = replace(loaded.config.backbone, settings=settings)
    return replace(
        loaded.config, backbone=sized, resolution=resolution or loaded.config.resolution
    )


def _converted_state(
    loaded: LoadedWeights, config: NetworkConfig, dtype: torch.dtype, seed: int
) -> Mapping[str, Tensor]:
    """All parameters in the file's new number format; checked against the network where we know
    it.
    """
    if (
        loaded.kind == "edit3r"
    ):  # any architecture: names and shapes are taken as they are
        return {name: value.to(dtype) for name, value in loaded.state.items()}
    network = empty_network(config)
    for _, leaf in fill(network, loaded, seed):
        leaf.to(dtype)
    return {name: value.detach() for name, value in network.named_parameters()}


def _parse_config(text: bytes, path: Path) -> tuple[NetworkConfig, str]:
    """(the network that the JSON text of `path` describes, what it says of the licence)."""
    try:
        content = json.loads(text)
        if content.get("format", FORMAT) != FORMAT:
            raise InputError(
                f"{path}: format {content['format']} is newer than this edit3r knows ({FORMAT})."
            )
        return NetworkConfig.from_json(content), content.get("licence", "not stated")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: not a configuration of edit3r weights ({type(error).__name__}: {error})."
        ) from None


def _read_safetensors(path: Path) -> dict[str, Tensor]:
    """Tensors of a safetensors file, left on disk until used."""
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            return {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError) as error:
        raise InputError(
            f"{path}: not a readable safetensors file ({error})."
        ) from None


def _check_keys(network: nn.Module, loaded: LoadedWeights) -> None:
    """Raise InputError that names missing, unexpected and wrongly shaped keys, unless everything
    fits.
    """
    wanted = dict(network.named_parameters())
    found = {
        "missing": [
            name
            for name in wanted
            if name not in loaded.state and not loaded.is_drawn(name)
        ],
        "unexpected": [
            *loaded.unexpected,
            *(name for name in loaded.state if name not in wanted),
        ],
        "wrong shape": [
            f"{name} is {list(loaded.state[name].shape)}, expected {list(value.shape)}"
            for name, value in wanted.items()
            if name in loaded.state and loaded.state[name].shape != value.shape
        ],
    }
    problems = [
        f"{len(keys)} {what} ({_some(keys)})" for what, keys in found.items() if keys
    ]
    if problems:
        raise InputError(
            f"{loaded.source}: the weights do not fit the network: {'; '.join(problems)}. Choose "
            "the sizes of the "
            f"checkpoint (--set reconstructor.backbone.KEY=VALUE) or another checkpoint."
        )


def _some(keys: list[str]) -> str:
    more = f" and {len(keys) - SHOWN} more" if len(keys) > SHOWN else ""
    return ", ".join(keys[:SHOWN]) + more


def _fill_leaf(name: str, leaf: nn.Module, loaded: LoadedWeights) -> None:
    for key, old in list(leaf.named_parameters(recurse=False)):
        stored = loaded.state[f"{name}.{key}"]
        value = torch.empty(stored.shape, dtype=torch.float32).copy_(
            stored
        )  # a copy of our own, off the file's pages
        release_pages(stored)
        if not value.isfinite().all():
            count = int((~value.isfinite()).sum())
            raise InputError(
                f"{loaded.source}: {name}.{key} holds {count} values that are not finite."
            )
        setattr(leaf, key, nn.Parameter(value, requires_grad=old.requires_grad))


def _download(source: str) -> Path:
    """Fetch (or find in the local cache) the weights of a hub id; returns a file or folder."""
    found = _HUB_ID.fullmatch(source)
    repo, revision, file = found["repo"], found["revision"], found["file"]
    if revision is None:
        raise InputError(
            f"{source}: no such file, and as a hub id it needs a pinned revision, for example "
            f"{repo}@main or, better, "
            f"{repo}@<commit>."
        )
    try:
        import huggingface_hub
    except ImportError:
        raise MissingDependencyError(
            f"weights {source!r} need huggingface_hub; install with: pip install huggingface_hub"
        ) from None
    try:
        if file is not None:
            return Path(huggingface_hub.hf_hub_download(repo, file, revision=revision))
        return Path(
            huggingface_hub.snapshot_download(
                repo, revision=revision, allow_patterns=[CONFIG, WEIGHTS]
            )
        )
    except (
        Exception
    ) as error:  # the library raises many kinds: network, permission, missing revision
        reason = " ".join(str(error).split())[:200]
        raise InputError(
            f"{source}: could not be fetched from the hub ({type(error).__name__}: {reason})."
        ) from error
