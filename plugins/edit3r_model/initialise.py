"""Build modules without memory for weights, and fill them leaf by leaf, so that no second copy is ever needed."""

import zlib
from collections.abc import Callable

import torch
from torch import nn


def construct(module: nn.Module, build: Callable[[], None], seed: int | None) -> None:
    """Run `build` on the meta device; then, unless `seed` is None, draw every weight."""
    with torch.device("meta"):
        build()
    if seed is not None:
        for name in leaf_names(module):
            draw_leaf(module, name, module.get_submodule(name), seed)


def leaf_names(module: nn.Module) -> list[str]:
    """Dotted names of every submodule that holds parameters itself."""
    return [name for name, part in module.named_modules() if next(part.parameters(recurse=False), None) is not None]


def draw_leaf(module: nn.Module, name: str, leaf: nn.Module, seed: int) -> None:
    """Give `module`'s leaf `name` memory on the CPU and initial weights.

    They depend on `seed` and the name alone, so a network drawn in pieces equals one drawn at once.
    `module.initial_name(name)` says after which leaf this one is named (two with one name start equal), and
    `module.initial_leaf(name, leaf)` may replace torch's default values.
    """
    leaf.to_empty(device="cpu", recurse=False)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed ^ zlib.crc32(module.initial_name(name).encode()))
        leaf.reset_parameters()
        module.initial_leaf(name, leaf)
