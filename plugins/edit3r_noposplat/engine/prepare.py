"""Turn one loaded layer into the form the plan asks for, while the rest of the network is still on disk."""

import torch
from torch import nn

from edit3r_noposplat.engine.int8 import Int8Conv, Int8Linear
from edit3r_noposplat.engine.packed import Activation, FusedConv, PackedLinear
from edit3r_noposplat.engine.plan import DTYPES, EnginePlan, Precision
from edit3r_noposplat.engine.winograd import WinogradConv

_ACTIVATIONS: dict[type, Activation] = {nn.GELU: "gelu", nn.ReLU: "relu"}
_WINOGRAD_PARENTS = ("trunk.fuse.0.skip", "trunk.fuse.0.refine")
MIN_INT8_CHANNELS = 64
MIN_WINOGRAD_CHANNELS = 192
"""Narrower layers spend more on quantising or transforming than the products save."""


def prepare_leaf(network: nn.Module, name: str, leaf: nn.Module, plan: EnginePlan, device: torch.device) -> None:
    """Convert the leaf called `name` in place: dtype, memory layout, device, or another class altogether."""
    precision = plan.backbone if name.startswith("backbone.") else plan.head
    if plan.packed and isinstance(leaf, nn.Linear | nn.Conv2d):
        activation = _take_activation(network, name)
        make = _linear if isinstance(leaf, nn.Linear) else _conv
        network.set_submodule(name, make(name, leaf, precision, activation, plan))
        return
    dtype = DTYPES.get(precision, torch.float32)
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


def _linear(name: str, leaf: nn.Linear, precision: Precision, activation: Activation, plan: EnginePlan) -> nn.Module:
    if precision == "int8" and min(leaf.in_features, leaf.out_features) >= MIN_INT8_CHANNELS:
        return Int8Linear(leaf, activation)
    return PackedLinear(leaf, DTYPES.get(precision, torch.float32), activation)


def _conv(name: str, leaf: nn.Conv2d, precision: Precision, activation: Activation, plan: EnginePlan) -> nn.Module:
    channels = min(leaf.in_channels, leaf.out_channels)
    if precision == "int8" and channels >= MIN_INT8_CHANNELS:
        return Int8Conv(leaf, activation)
    if plan.winograd and channels >= MIN_WINOGRAD_CHANNELS and _on_large_map(name, leaf):
        return WinogradConv(leaf, activation)
    return FusedConv(leaf, DTYPES.get(precision, torch.float32), activation)


def _on_large_map(name: str, leaf: nn.Conv2d) -> bool:
    """3x3 layers at a quarter of the picture's resolution and above: most of the work, a seventh of the weights."""
    if leaf.kernel_size != (3, 3) or leaf.stride != (1, 1):
        return False
    return "trunk." not in name or any(parent in name for parent in _WINOGRAD_PARENTS)
