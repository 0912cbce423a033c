"""Any readable checkpoint to our own format."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from edit3r.errors import InputError
from edit3r_model.checkpoints.fill import fill
from edit3r_model.checkpoints.load import load_weights
from edit3r_model.checkpoints.loaded import LoadedWeights, NetworkConfig, PartConfig
from edit3r_model.checkpoints.native import CONFIG, WEIGHTS, save_weights
from edit3r_model.checkpoints.parameters import empty_network


@dataclass(frozen=True)
class ConversionOptions:
    """What a checkpoint does not say itself."""

    dtype: str = "float32"
    resolution: int | None = None
    heads: int | None = None
    decoder_heads: int | None = None
    licence: str | None = None
    seed: int = 0


def convert(source: str, out: Path, options: ConversionOptions) -> str:
    """Read `source`, check every key, write it to folder `out`; returns a sentence for the user.

    Parts that the file lacks by design (MASt3R has no attribute head) are drawn from `options.seed`.
    """
    loaded = load_weights(source)
    if Path(source).resolve() in (out.resolve(), (out / WEIGHTS).resolve()):
        raise InputError(f"{out}: source and target are the same; choose another folder.")
    config = _config(loaded, options)
    state = _state(loaded, config, options)
    provenance = {"converted_from": Path(source).name, "sha256": loaded.sha256, "kind": loaded.kind}
    if loaded.drawn:
        provenance["drawn_at_random"] = list(loaded.drawn)
    save_weights(out, state, config, options.licence or loaded.licence, provenance)
    parameters = sum(value.numel() for value in state.values())
    drawn = f" {', '.join(loaded.drawn)} are random: train before use." if loaded.drawn else ""
    return f"{out}: {WEIGHTS} with {parameters:,} parameters in {options.dtype}, {CONFIG} beside it.{drawn}"


def _config(loaded: LoadedWeights, options: ConversionOptions) -> NetworkConfig:
    """The file's sizes with what the options add, spelled out in full."""
    config = loaded.config
    given = {"heads": options.heads, "decoder_heads": options.decoder_heads}
    backbone = {**config.backbone.settings, **{key: value for key, value in given.items() if value is not None}}
    if loaded.kind != "edit3r":
        network = empty_network(replace(config, backbone=PartConfig(config.backbone.name, backbone)))
        backbone |= {"heads": network.backbone.heads, "decoder_heads": network.backbone.decoder_heads}
    return NetworkConfig(
        PartConfig(config.backbone.name, backbone), config.head, options.resolution or config.resolution
    )


def _state(loaded: LoadedWeights, config: NetworkConfig, options: ConversionOptions) -> Mapping[str, Tensor]:
    """All parameters in the file's new number format; checked against the network where we know it."""
    dtype = getattr(torch, options.dtype)
    if loaded.kind == "edit3r":  # any architecture: names and shapes are taken as they are
        return {name: value.to(dtype) for name, value in loaded.state.items()}
    network: Any = empty_network(config)
    for _, leaf in fill(network, loaded, options.seed):
        leaf.to(dtype)
    return {name: value.detach() for name, value in network.named_parameters()}
