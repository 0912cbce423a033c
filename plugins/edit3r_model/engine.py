"""In which precision the full network runs, and how a loaded layer is brought into it.

`make_plan` decides from settings and from what this machine was measured to do, before anything
loads; `prepare_leaf` then converts one layer after the other while the rest of the network is still
on disk.
"""

import time
from dataclasses import dataclass
from functools import cache
from typing import Literal

import torch
from torch import nn

from edit3r.contract.errors import SettingsError
from edit3r.contract.reporting import note, warn

Precision = Literal["float32", "bfloat16", "float16"]
WORTHWHILE = 1.2
"""How much faster bfloat16 must be than float32 to be chosen; less would cost digits for nothing.
"""
MEASURED_SECONDS = 0.05  # no figure kept
CPU = torch.device("cpu")


@dataclass(frozen=True)
class EnginePlan:
    """What the layers of a network hold and compute in, and where."""

    backbone: Precision = "float32"
    head: Precision = "float32"
    device: torch.device = CPU


def make_plan(
    precision: Precision | Literal["auto"],
    head_precision: Precision | Literal["auto"],
    device: torch.device,
) -> EnginePlan:
    """The plan for a device. Raises SettingsError for a precision that it does not run."""
    if precision == "float16" and device.type == "cpu":
        raise SettingsError(
            "reconstructor.precision: float16 is for CUDA; on a CPU use bfloat16."
        )
    if precision == "auto":
        precision = "bfloat16" if bfloat16_gain(device) >= WORTHWHILE else "float32"
        note("reconstructor.precision", f"{precision}, after measuring")
    if head_precision == "auto":
        head_precision = precision
    if "bfloat16" in (precision, head_precision) and bfloat16_gain(device) < 1:
        gain = bfloat16_gain(device)
        warn(
            f"products take {1 / gain:.1f} times as long in bfloat16 as in float32 on this "
            "machine, so float32 is used."
        )
        precision = "float32" if precision == "bfloat16" else precision
        if head_precision == "bfloat16":
            head_precision = "float32"
    return EnginePlan(precision, head_precision, device)


@cache
def bfloat16_gain(device: torch.device) -> float:
    """How many times as fast as in float32 a linear layer is in bfloat16 on `device`, by 50 ms of
    each in turns.

    A processor may know bfloat16, only emulate it, or be slow in float32: nothing but the time
    tells.
    """
    layers: list[tuple[nn.Linear, torch.Tensor]] = []
    seconds: list[list[float]] = []
    for dtype in (torch.float32, torch.bfloat16):
        x = torch.ones(512, 1024, device=device, dtype=dtype)
        layers.append((nn.Linear(1024, 1024, device=device, dtype=dtype), x))
        seconds.append([])
    with torch.inference_mode():
        while sum(sum(taken) for taken in seconds) < 2 * MEASURED_SECONDS:
            for (layer, x), taken in zip(layers, seconds):
                start = _clock(device)
                layer(x)
                taken.append(max(_clock(device) - start, 1e-4))
    return min(seconds[0]) / min(seconds[1])


def _clock(device: torch.device) -> float:
    """Seconds, when all work on `device` is done; on a CPU those of this process."""
    if device.type != "cuda":
        return time.process_time()
    torch.cuda.synchronize(device)
    return time.perf_counter()


def prepare_leaf(name: str, leaf: nn.Module, plan: EnginePlan) -> None:
    """Convert the leaf called `name` in place: dtype, memory layout, device."""
    precision = plan.backbone if name.startswith("backbone.") else plan.head
    leaf.to(device=plan.device, dtype=getattr(torch, precision))
    if isinstance(leaf, nn.Conv2d | nn.ConvTranspose2d):
        # torch's stubs lack it
        leaf.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
