"""The fast forms of the full network's layers: which one each part takes, and how a loaded layer is turned into it.

`make_plan` decides from settings and machine before anything loads; `prepare_leaf` then converts one layer after the
other while the rest of the network is still on disk. The layers themselves are in `fast_layers` and `winograd`.
"""

import platform
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import torch
from torch import nn

from edit3r.errors import SettingsError
from edit3r_model.dpt_head import ResidualUnit
from edit3r_model.fast_layers import Activation, FusedConv, Int8Conv, Int8Linear, PackedLinear, StoredLinear
from edit3r_model.transformer import DecoderBlock, EncoderBlock, adjacent_order
from edit3r_model.winograd import WinogradConv

Precision = Literal["float32", "bfloat16", "float16", "int8"]
Form = Literal[Precision, "stored"]
"""What a layer holds and computes in; stored: bfloat16 weights, float32 arithmetic."""
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}
_ACTIVATIONS: dict[type, Activation] = {nn.GELU: "gelu", nn.ReLU: "relu"}
_WINOGRAD_PARENTS = ("trunk.fuse.0.skip", "trunk.fuse.0.refine")
MIN_INT8_CHANNELS = 64
MIN_WINOGRAD_CHANNELS = 128
"""Narrower layers spend more on quantising or transforming than the products save."""


@dataclass(frozen=True)
class EnginePlan:
    """How the layers of a network are to be held and run."""

    backbone: Form  # int8: linears, with float32 between them
    head: Form
    packed: bool  # weights in oneDNN's own layout; inference on a CPU only
    winograd: bool  # 3x3 convolutions on large maps with a quarter of the multiplications


def make_plan(
    precision: Precision, head_precision: Precision | Literal["auto"], packed: bool, device: torch.device
) -> EnginePlan:
    """Return the plan for a device; raises SettingsError for a precision that the device does not run."""
    on_cpu = device.type == "cpu"
    if precision == "float16" and on_cpu:
        raise SettingsError("reconstructor.precision: float16 is for CUDA; on a CPU use bfloat16 or int8.")
    if precision == "int8" and not on_cpu:
        raise SettingsError("reconstructor.precision: int8 is for CPUs; on CUDA use bfloat16 or float16.")
    if precision == "int8" and not packed:
        raise SettingsError("reconstructor.precision: int8 needs engine packed.")
    if head_precision == "auto":
        head_precision = _head_precision(precision)
    packed = packed and on_cpu and torch.backends.mkldnn.is_available()
    backbone, head = (_form(value, packed) for value in (precision, head_precision))
    return EnginePlan(backbone, head, packed, packed and head in ("float32", "stored") and _mkl_is_fast())


def _head_precision(precision: Precision) -> Precision:
    """The heads follow the backbone; beside int8 linears they take bfloat16 where the processor multiplies it."""
    if precision != "int8":
        return precision
    return "bfloat16" if has_bf16_instructions() else "int8"


def _form(precision: Precision, packed: bool) -> Form:
    """Emulated, bfloat16 products cost four times those of float32: a CPU that must emulate them only stores it."""
    return "stored" if precision == "bfloat16" and packed and not has_bf16_instructions() else precision


def has_bf16_instructions() -> bool:
    """Tell whether the CPU multiplies bfloat16 itself (AVX512-BF16, AMX, or Arm's BF16) instead of emulating it."""
    return re.search(r"\b(avx512_bf16|amx_bf16|bf16)\b", _cpu_info()) is not None


def _mkl_is_fast() -> bool:
    """MKL's batched float32 products, on which our Winograd convolution rests, run at full speed on Intel only."""
    return "GenuineIntel" in _cpu_info()


@cache
def _cpu_info() -> str:
    """Vendor and feature flags of the first processor; elsewhere than on Linux only what Python tells."""
    path = Path("/proc/cpuinfo")
    if not path.is_file():
        return platform.processor()
    return path.read_text(encoding="utf-8").split("\n\n", 1)[0]


def prepare_leaf(network: nn.Module, name: str, leaf: nn.Module, plan: EnginePlan, device: torch.device) -> None:
    """Convert the leaf called `name` in place: dtype, memory layout, device, or another class altogether."""
    form = plan.backbone if name.startswith("backbone.") else plan.head
    if plan.packed and isinstance(leaf, nn.Linear | nn.Conv2d):
        if form in ("float32", "int8", "stored"):  # queries and keys are float32, as complex products need
            _make_pairs_adjacent(network, name, leaf)
        activation = _take_activation(network, name)
        linear = isinstance(leaf, nn.Linear)
        fast = _linear(leaf, form, activation) if linear else _conv(name, leaf, form, activation, plan)
        network.set_submodule(name, fast)
        return
    dtype = DTYPES.get(form, torch.float32)
    if isinstance(leaf, nn.Conv2d | nn.ConvTranspose2d):
        leaf.to(device=device, dtype=dtype, memory_format=torch.channels_last)
    else:
        leaf.to(device=device, dtype=dtype)


def compile_blocks(network: nn.Module) -> None:
    """Compile the repeated blocks one by one with `torch.compile`; a network without such blocks as a whole.

    Blocks of one kind share their compiled code, so a deep network compiles as fast as a shallow one, and the control
    flow around them (roles, strips, sizes) stays ordinary Python. It happens at the first use.
    """
    blocks = [part for part in network.modules() if isinstance(part, EncoderBlock | DecoderBlock | ResidualUnit)]
    for module in blocks or [network]:
        module.compile()


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
    """Reorder the channels of a layer that gives queries or keys so that those rotated together stand side by side.

    Queries and keys in the same order have the same scores. A parent says in `rotated` which layers these are.
    """
    parent_name, _, own = name.rpartition(".")
    parent = network.get_submodule(parent_name)
    count = getattr(parent, "rotated", {}).get(own)
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
    """The fast form of a linear layer."""
    if form == "int8" and min(leaf.in_features, leaf.out_features) >= MIN_INT8_CHANNELS:
        return Int8Linear(leaf, activation)
    if form == "stored":
        return StoredLinear(leaf, activation)
    return PackedLinear(leaf, DTYPES.get(form, torch.float32), activation)


def _conv(name: str, leaf: nn.Conv2d, form: Form, activation: Activation, plan: EnginePlan) -> nn.Module:
    """The fast form of a convolution."""
    channels = min(leaf.in_channels, leaf.out_channels)
    if form == "int8" and channels >= MIN_INT8_CHANNELS:
        return Int8Conv(leaf, activation)
    if plan.winograd and channels >= MIN_WINOGRAD_CHANNELS and _on_large_map(name, leaf):
        return WinogradConv(leaf, activation)
    if form == "stored":
        return FusedConv(leaf, torch.bfloat16, activation, arithmetic=torch.float32)
    return FusedConv(leaf, DTYPES.get(form, torch.float32), activation)


def _on_large_map(name: str, leaf: nn.Conv2d) -> bool:
    """3x3 layers at a quarter of the image's resolution and above: most of the work, a seventh of the weights."""
    if leaf.kernel_size != (3, 3) or leaf.stride != (1, 1):
        return False
    return "trunk." not in name or any(parent in name for parent in _WINOGRAD_PARENTS)
