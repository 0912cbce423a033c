"""How much memory a run will take, before it starts, and a sentence when it is too much."""

from contextlib import contextmanager
from pathlib import Path

import torch
from torch import nn

from edit3r.errors import RunError
from edit3r.interfaces import Backbone

_WORKING_TENSORS = 14
"""Token-sized tensors alive at the peak of a block: residual, norm, q, k, v, their turned copies, MLP hidden (4)."""
_WORKING_MAPS = 5
"""Feature maps at half resolution alive at once in a dense head."""
_PER_GAUSSIAN = 4 * (2 * (3 + 83) + 86)
"""Bytes per pixel for raw maps, their stacked copies and the Gaussians in float32."""


def estimate_bytes(backbone: Backbone, batch: int, views: int, size: tuple[int, int], feature_width: int = 256) -> int:
    """Memory of one run beside the weights [bytes]; an estimate, usually within a factor of 1.5."""
    height, width = size
    tokens = batch * views * (height // backbone.patch_size) * (width // backbone.patch_size)
    channels = max(backbone.feature_widths)
    token_bytes = 4 * tokens * channels * (_WORKING_TENSORS + len(backbone.feature_widths))
    gathered = 4 * 2 * tokens * (views - 1) * channels  # keys and values of the other views
    maps = 4 * feature_width * (height // 2) * (width // 2) * _WORKING_MAPS  # one picture at a time
    return token_bytes + gathered + maps + batch * views * height * width * _PER_GAUSSIAN


def available_bytes(device: torch.device) -> int | None:
    """Free memory of `device`, None where the system does not tell."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    table = Path("/proc/meminfo")
    if not table.is_file():
        return None
    line = next((x for x in table.read_text().splitlines() if x.startswith("MemAvailable:")), None)
    return int(line.split()[1]) * 1024 if line else None


def check_fits(needed: int, device: torch.device, what: str) -> None:
    """Raise RunError that says what to lower when `needed` bytes are more than `device` has free."""
    free = available_bytes(device)
    if free is not None and needed > free:
        raise RunError(
            f"{what} needs about {needed / 2**30:.1f} GiB of memory on {device}, {free / 2**30:.1f} GiB are free; "
            f"{ADVICE}."
        )


ADVICE = "lower reconstructor.resolution, use fewer views, or set reconstructor.precision to bfloat16 or int8"


@contextmanager
def explaining_exhaustion(what: str):
    """Turn running out of memory into a RunError that says what to lower."""
    try:
        yield
    except (MemoryError, torch.OutOfMemoryError) as error:
        raise RunError(f"{what} ran out of memory; {ADVICE}.") from error
    except RuntimeError as error:
        if "not enough memory" not in str(error) and "can't allocate memory" not in str(error):
            raise
        raise RunError(f"{what} ran out of memory; {ADVICE}.") from error


def weight_bytes(network: nn.Module, bytes_per_value: int) -> int:
    """Memory the weights of a network take, whether loaded or not [bytes]."""
    return bytes_per_value * sum(value.numel() for value in network.parameters())
