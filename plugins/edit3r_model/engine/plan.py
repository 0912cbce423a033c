"""Which numeric form each part of the network takes, decided from settings and machine before anything loads."""

import platform
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import torch

from edit3r.errors import SettingsError

Precision = Literal["float32", "bfloat16", "float16", "int8"]
Form = Literal[Precision, "stored"]
"""What a layer holds and computes in; stored: bfloat16 weights, float32 arithmetic."""
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}


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
    """The plan for a device; raises SettingsError for a precision that the device does not run."""
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
    """True when the CPU multiplies bfloat16 itself (AVX512-BF16, AMX, or Arm's BF16) instead of emulating it."""
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
