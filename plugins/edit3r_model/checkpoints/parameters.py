"""Names and shapes of a network's parameters, without any memory for them."""

from collections.abc import Mapping
from typing import Any

from edit3r.config import make_settings
from edit3r_model.backbone import AsymmetricViT
from edit3r_model.checkpoints.loaded import NetworkConfig
from edit3r_model.head import DptGaussianHead
from edit3r_model.network import GaussianNetwork


def empty_network(config: NetworkConfig, **backbone: Any) -> GaussianNetwork:
    """The official network of `config` with empty weights; `backbone` overrides backbone settings."""
    settings = {**config.backbone.settings, **backbone, "seed": None}
    body = AsymmetricViT(make_settings(AsymmetricViT.Settings, settings, "backbone"))
    head_settings: Mapping[str, Any] = {**config.head.settings, "seed": None}
    return GaussianNetwork(body, DptGaussianHead(make_settings(DptGaussianHead.Settings, head_settings, "head"), body))


def parameter_names(config: NetworkConfig) -> list[str]:
    """All parameter names of the official network with `config`'s sizes; the number of heads does not matter."""
    heads = {"heads": 1, "decoder_heads": 1}  # any divisor: no shape depends on it
    return [name for name, _ in empty_network(config, **heads).named_parameters()]
