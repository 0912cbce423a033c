"""Memory of the full network: built empty, filled layer by layer, and estimated before a run
starts.
"""

import ctypes
import mmap
import sys
import zlib
from collections.abc import Callable

import torch
from torch import Tensor, nn

from edit3r.contract.errors import RunError
from edit3r.contract.interfaces import Backbone
from edit3r.contract.reporting import available_memory

ADVICE = "lower reconstructor.resolution, use fewer views, or set reconstructor.precision=bfloat16"

_WORKING_TENSORS = 14
"""Token-sized tensors alive at the peak of a block: residual, norm, q, k, v, their rotated copies,
MLP hidden (4).
"""
_WORKING_MAPS = 5
"""Feature maps at half resolution alive at once in a dense head."""
_PER_GAUSSIAN = 4 * (2 * (3 + 83) + 86)
"""Bytes per Gaussian for raw maps, their stacked copies and the Gaussians in float32."""
_PAGEOUT = 21
"""MADV_PAGEOUT (Linux 5.4): drops clean file pages from the process, never data; Python's mmap does
not name it.
"""


def construct(module: nn.Module, build: Callable[[], None], seed: int | None) -> None:
    """Run `build` without memory for weights; unless `seed` is None, draw initial weights then."""
    with torch.device("meta"):
        build()
    if seed is not None:
        for name in leaf_names(module):
            draw_leaf(name, module.get_submodule(name), seed)


def leaf_names(module: nn.Module) -> list[str]:
    """Return the dotted names of all submodules that hold parameters themselves."""
    names = [name for name, _ in module.named_parameters()]
    return list(dict.fromkeys(name.rpartition(".")[0] for name in names))


def draw_leaf(name: str, leaf: nn.Module, seed: int) -> None:
    """Give the layer called `name` memory on the CPU and initial weights.

    They depend on `seed` and `name` alone, so a network drawn in pieces equals one drawn at once.
    Both decoders of the backbone start equal.
    """
    leaf.to_empty(device="cpu", recurse=False)
    with torch.random.fork_rng(devices=[]):
        same = name.replace("decoders.1.", "decoders.0.")
        # The CPU's alone: `torch.manual_seed` keeps a call, with its stack, for each absent GPU.
        torch.default_generator.manual_seed(seed ^ zlib.crc32(same.encode()))
        assert callable(leaf.reset_parameters)  # as of every layer with weights
        leaf.reset_parameters()


def release_pages(tensor: Tensor) -> None:
    """Take the pages of a memory-mapped file under `tensor` out of memory; the data stay valid.
    Linux only.

    Without this the mapped file counts as resident until all of it is read, beside the copy in use.
    The advice is safe for any tensor; where the system refuses it nothing happens.
    """
    if not sys.platform.startswith("linux"):
        return
    page = mmap.PAGESIZE
    start = -(-tensor.data_ptr() // page) * page
    length = (tensor.data_ptr() + tensor.nbytes) // page * page - start
    if length > 0:
        ctypes.CDLL(None).madvise(
            ctypes.c_void_p(start), ctypes.c_size_t(length), _PAGEOUT
        )


def estimate_bytes(
    backbone: Backbone,
    batch: int,
    views: int,
    size: tuple[int, int],
    feature_width: int = 256,
    per_pixel: int = 1,
) -> int:
    """Estimate the memory of one run beside the weights [bytes], usually within a factor of 1.5."""
    height, width = size
    pixels = height * width
    tokens = batch * views * pixels // backbone.patch_size**2
    # At the peak of a block, with the levels kept and the keys and values of the other views.
    tensors = _WORKING_TENSORS + len(backbone.feature_widths) + 2 * (views - 1)
    blocks = 4 * tokens * max(backbone.feature_widths) * tensors
    # Dense heads take one image at a time.
    heads = feature_width * pixels * _WORKING_MAPS
    return blocks + heads + batch * views * pixels * per_pixel * _PER_GAUSSIAN


def available_bytes(device: torch.device) -> int | None:
    """Return the free memory of `device` [bytes], None where the system does not tell."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    return available_memory()


def check_fits(needed: int, device: torch.device, what: str) -> None:
    """Raise RunError that says what to lower when `device` has fewer bytes free than `needed`."""
    free = available_bytes(device)
    if free is not None and needed > free:
        raise RunError(
            f"{what} needs about {needed / 2**30:.1f} GiB of memory on {device}, "
            f"{free / 2**30:.1f} GiB are free; {ADVICE}."
        )
