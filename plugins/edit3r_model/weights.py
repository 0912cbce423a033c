"""From a reconstructor's settings and empty parts to a network with weights, in the form the settings ask for."""

from collections.abc import Iterator
from typing import Any

import torch
from torch import nn

from edit3r.config import Settings, make_settings
from edit3r.errors import MissingDependencyError, SettingsError
from edit3r.interfaces import Backbone, GaussianHead
from edit3r.reporting import note, progress, warn
from edit3r_model.checkpoints import LoadedWeights, fill, load_weights
from edit3r_model.checkpoints.loaded import PartConfig
from edit3r_model.checkpoints.pages import release_heap
from edit3r_model.engine import make_plan, prepare_leaf
from edit3r_model.engine.plan import EnginePlan
from edit3r_model.initialise import draw_leaf, leaf_names
from edit3r_model.network import GaussianNetwork

RANDOM = "random"
LEAVES_PER_RELEASE = 16
"""How often what conversion freed goes back to the system; otherwise it adds up to a tenth of the network."""


def load_network(
    settings: Settings, backbone: Backbone, head: GaussianHead
) -> tuple[LoadedWeights | None, GaussianNetwork]:
    """(what was loaded, the network in evaluation mode on its device); None loaded means drawn at random."""
    device = choose_device(settings.device)
    plan = make_plan(settings.precision, settings.head_precision, settings.engine == "packed", device)
    if settings.weights == RANDOM:
        loaded, network = None, GaussianNetwork(backbone, head)
        warn("the network's weights are random: the result is noise, of use for tests and speed only.")
        note("reconstructor.weights", {"source": RANDOM})
        source = _draw(network, settings.seed)
    else:
        loaded = load_weights(settings.weights)
        network = sized_like(loaded, backbone, head)
        _tell(loaded, network)
        source = fill(network, loaded, settings.seed)
    if "stored" in (plan.backbone, plan.head):
        note("reconstructor.arithmetic", "float32 on weights stored in bfloat16, which this processor would emulate")
    _prepare(network, source, plan, device)
    return loaded, network.eval()


def choose_device(name: str) -> torch.device:
    """`auto` or a torch device name; raises MissingDependencyError for CUDA where there is none."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise SettingsError(f"reconstructor.device: expected auto, cpu, cuda or cuda:N, got {name!r}.") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise MissingDependencyError(f"reconstructor.device: {name} asked for, but this torch sees no CUDA device.")
    return device


def sized_like(loaded: LoadedWeights, backbone: Backbone, head: GaussianHead) -> GaussianNetwork:
    """A network of the parts' kinds with the sizes of `loaded`; settings the user gave explicitly win."""
    body = _sized(backbone, loaded.config.backbone, loaded.source, "backbone")
    return GaussianNetwork(body, _sized(head, loaded.config.head, loaded.source, "head", body))


def _sized(part: nn.Module, config: PartConfig, source: str, kind: str, *needs: nn.Module) -> nn.Module:
    """`part` rebuilt without memory, in the size `config` says."""
    name = part.offer.component.name if hasattr(part, "offer") else config.name
    if name != config.name:
        raise SettingsError(
            f"{source} holds a {kind} {config.name!r}, the settings say {name!r}; "
            f"--set reconstructor.{kind}={config.name} takes the right one."
        )
    explicit: dict[str, Any] = {key: getattr(part.settings, key) for key in part.settings.model_fields_set}
    values = {**config.settings, **explicit, "seed": None}
    settings = make_settings(type(part).Settings, values, kind)
    rebuilt = type(part)(settings, *needs)
    if hasattr(part, "offer"):
        rebuilt.offer = part.offer
    return rebuilt


def _draw(network: GaussianNetwork, seed: int) -> Iterator[tuple[str, nn.Module]]:
    """Initial weights, leaf by leaf; leaves that have weights already keep them."""
    for name in leaf_names(network):
        leaf = network.get_submodule(name)
        if next(leaf.parameters(recurse=False)).is_meta:
            draw_leaf(network, name, leaf, seed)
        yield name, leaf


def _prepare(
    network: GaussianNetwork, source: Iterator[tuple[str, nn.Module]], plan: EnginePlan, device: torch.device
) -> None:
    """Convert every leaf as soon as it has weights, so that the network never exists twice."""
    total = len(leaf_names(network))
    for done, (name, leaf) in enumerate(source, start=1):
        prepare_leaf(network, name, leaf, plan, device)
        progress("loading weights", done, total)
        if done % LEAVES_PER_RELEASE == 0 or done == total:
            release_heap()


def _tell(loaded: LoadedWeights, network: GaussianNetwork) -> None:
    """Facts about the weights for the run's manifest, and what a user must know before trusting the result."""
    note("reconstructor.weights", loaded.facts())
    if loaded.kind == "noposplat" and hasattr(network.backbone, "heads"):
        heads = network.backbone.heads, network.backbone.decoder_heads
        note("reconstructor.attention_heads", f"{heads[0]} and {heads[1]}: settings, else 64 channels each")
    if loaded.drawn:
        warn(
            f"{loaded.source} initialises the network for training; it does not hold {', '.join(loaded.drawn)}, which "
            f"are random: the Gaussians' colours and shapes mean nothing yet."
        )
