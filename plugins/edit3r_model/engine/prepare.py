"""Turn one loaded layer into the form the plan asks for, while the rest of the network is still on disk."""

import torch
from torch import nn

from edit3r_model.engine.int8 import Int8Conv, Int8Linear
from edit3r_model.engine.packed import Activation, FusedConv, PackedLinear, StoredLinear
from edit3r_model.engine.plan import DTYPES, EnginePlan, Form
from edit3r_model.engine.winograd import WinogradConv
from edit3r_model.rotary import adjacent_order

_ACTIVATIONS: dict[type, Activation] = {nn.GELU: "gelu", nn.ReLU: "relu"}
_WINOGRAD_PARENTS = ("trunk.fuse.0.skip", "trunk.fuse.0.refine")
MIN_INT8_CHANNELS = 64
MIN_WINOGRAD_CHANNELS = 128
"""Narrower layers spend more on quantising or transforming than the products save."""


def prepare_leaf(network: nn.Module, name: str, leaf: nn.Module, plan: EnginePlan, device: torch.device) -> None:
    """Convert the leaf called `name` in place: dtype, memory layout, device, or another class altogether."""
    form = plan.backbone if name.startswith("backbone.") else plan.head
    if plan.packed and isinstance(leaf, nn.Linear | nn.Conv2d):
        if form in ("float32", "int8", "stored"):  # queries and keys are float32, as complex products need
            _make_pairs_adjacent(network, name, leaf)
        activation = _take_activation(network, name)
        made = (
            _linear(leaf, form, activation)
            if isinstance(leaf, nn.Linear)
            else _conv(name, leaf, form, activation, plan)
        )
        network.set_submodule(name, made)
        return
    dtype = DTYPES.get(form, torch.float32)
    if isinstance(leaf, nn.Conv2d | nn.ConvTranspose2d):
        leaf.to(device=device, dtype=dtype, memory_format=torch.channels_last)
    else:
        leaf.to(device=device, dtype=dtype)


def _take_activation(network: nn.Module, name: str) -> Activation:
    """The activation after the layer `name`, removed from its parent because the layer will do it; "none" without one.

    A parent says in `fusable` which activation follows which of its layers.
    """
    parent_name, _, own = name.rpartition(".")
    parent = network.get_submodule(parent_name)
    attribute = getattr(parent, "fusable", {}).get(own)
    if attribute is None:
        return "none"
    activation = _ACTIVATIONS[type(getattr(parent, attribute))]
    setattr(parent, attribute, nn.Identity())
    return activation


def _make_pairs_adjacent(network: nn.Module, name: str, leaf: nn.Module) -> None:
    """Reorder the channels of a layer that gives queries or keys so that those turned together stand side by side.

    Queries and keys in the same order have the same scores. A parent says in `turned` which layers these are.
    """
    parent_name, _, own = name.rpartition(".")
    parent = network.get_submodule(parent_name)
    count = getattr(parent, "turned", {}).get(own)
    if count is None:
        return
    width = leaf.in_features  # as many as all heads' queries have
    order = adjacent_order(width // parent.heads)
    rows = torch.arange(leaf.out_features)
    rows[: count * width] = rows[: count * width].view(-1, len(order))[:, order].flatten()
    for value in (leaf.weight, leaf.bias):
        value.data = value.data[rows]
    parent.adjacent = True


def _linear(leaf: nn.Linear, form: Form, activation: Activation) -> nn.Module:
    if form == "int8" and min(leaf.in_features, leaf.out_features) >= MIN_INT8_CHANNELS:
        return Int8Linear(leaf, activation)
    if form == "stored":
        return StoredLinear(leaf, activation)
    return PackedLinear(leaf, DTYPES.get(form, torch.float32), activation)


def _conv(name: str, leaf: nn.Conv2d, form: Form, activation: Activation, plan: EnginePlan) -> nn.Module:
    channels = min(leaf.in_channels, leaf.out_channels)
    if form == "int8" and channels >= MIN_INT8_CHANNELS:
        return Int8Conv(leaf, activation)
    if plan.winograd and channels >= MIN_WINOGRAD_CHANNELS and _on_large_map(name, leaf):
        return WinogradConv(leaf, activation)
    if form == "stored":
        return FusedConv(leaf, torch.bfloat16, activation, arithmetic=torch.float32)
    return FusedConv(leaf, DTYPES.get(form, torch.float32), activation)


def _on_large_map(name: str, leaf: nn.Conv2d) -> bool:
    """3x3 layers at a quarter of the picture's resolution and above: most of the work, a seventh of the weights."""
    if leaf.kernel_size != (3, 3) or leaf.stride != (1, 1):
        return False
    return "trunk." not in name or any(parent in name for parent in _WINOGRAD_PARENTS)
