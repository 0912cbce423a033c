"""Turn one loaded layer into the form the plan asks for, while the rest of the network is still on disk."""

import torch
from torch import nn

from edit3r_noposplat.blocks import Mlp
from edit3r_noposplat.engine.int8 import Int8Conv, Int8Linear
from edit3r_noposplat.engine.packed import FusedConv, PackedLinear
from edit3r_noposplat.engine.plan import DTYPES, EnginePlan
from edit3r_noposplat.engine.winograd import WinogradConv

_WINOGRAD_PARENTS = ("trunk.fuse.0.skip", "trunk.fuse.0.refine")
MIN_CHANNELS = 64
"""Narrower convolutions are too small for the int8 and Winograd forms to pay."""


def prepare_leaf(network: nn.Module, name: str, leaf: nn.Module, plan: EnginePlan, device: torch.device) -> None:
    """Convert the leaf called `name` in place: dtype, memory layout, device, or another class altogether."""
    precision = plan.backbone if name.startswith("backbone.") else plan.head
    dtype = DTYPES.get(precision, torch.float32)
    replacement = _packed(network, name, leaf, precision, dtype, plan) if plan.packed else None
    if replacement is not None:
        network.set_submodule(name, replacement)
        return
    if isinstance(leaf, nn.Conv2d | nn.ConvTranspose2d):
        leaf.to(device=device, dtype=dtype, memory_format=torch.channels_last)
    else:
        leaf.to(device=device, dtype=dtype)


def _packed(
    network: nn.Module, name: str, leaf: nn.Module, precision: str, dtype: torch.dtype, plan: EnginePlan
) -> nn.Module | None:
    """The CPU form of a layer, None where it stays as it is."""
    parent = network.get_submodule(name.rpartition(".")[0])
    if isinstance(leaf, nn.Linear):
        return _linear(parent, name, leaf, precision, dtype)
    return _conv(name, leaf, precision, dtype, plan) if isinstance(leaf, nn.Conv2d) else None


def _linear(parent: nn.Module, name: str, leaf: nn.Linear, precision: str, dtype: torch.dtype) -> nn.Module:
    activation = "none"
    if isinstance(parent, Mlp) and name.endswith(".fc1"):
        activation, parent.act = "gelu", nn.Identity()
    if precision == "int8" and min(leaf.in_features, leaf.out_features) >= MIN_CHANNELS:
        return Int8Linear(leaf, activation)
    return PackedLinear(leaf, dtype, activation)


def _conv(name: str, leaf: nn.Conv2d, precision: str, dtype: torch.dtype, plan: EnginePlan) -> nn.Module:
    wide = min(leaf.in_channels, leaf.out_channels) >= MIN_CHANNELS
    if precision == "int8" and wide:
        return Int8Conv(leaf)
    if plan.winograd and wide and _on_large_map(name, leaf):
        return WinogradConv(leaf)
    return FusedConv(leaf, dtype)


def _on_large_map(name: str, leaf: nn.Conv2d) -> bool:
    """3x3 layers at a quarter of the picture's resolution and above: most of the work, a seventh of the weights."""
    if leaf.kernel_size != (3, 3) or leaf.stride != (1, 1):
        return False
    return "trunk." not in name or any(parent in name for parent in _WINOGRAD_PARENTS)
