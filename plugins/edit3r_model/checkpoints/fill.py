"""Put loaded weights into a network leaf by leaf, checking every key, shape and value."""

from collections.abc import Iterator

import torch
from torch import nn

from edit3r.errors import InputError
from edit3r_model.checkpoints.loaded import LoadedWeights
from edit3r_model.checkpoints.pages import release_pages
from edit3r_model.initialise import draw_leaf, leaf_names

SHOWN = 4
"""Keys listed per kind of problem."""


def check(network: nn.Module, loaded: LoadedWeights) -> None:
    """Raise InputError that names missing, unexpected and wrongly shaped keys, unless everything fits."""
    wanted = dict(network.named_parameters())
    missing = [n for n in wanted if n not in loaded.state and not n.startswith(loaded.drawn or ("\0",))]
    unexpected = [*loaded.unexpected, *(n for n in loaded.state if n not in wanted)]
    wrong = [
        f"{name} is {list(loaded.state[name].shape)}, expected {list(value.shape)}"
        for name, value in wanted.items()
        if name in loaded.state and loaded.state[name].shape != value.shape
    ]
    found = (("missing", missing), ("unexpected", unexpected), ("wrong shape", wrong))
    problems = [f"{len(keys)} {what} ({_some(keys)})" for what, keys in found if keys]
    if problems:
        raise InputError(
            f"{loaded.source}: the weights do not fit the network: {'; '.join(problems)}. Choose the sizes of the "
            f"checkpoint (--set reconstructor.backbone.KEY=VALUE) or another checkpoint."
        )


def fill(network: nn.Module, loaded: LoadedWeights, seed: int = 0) -> Iterator[tuple[str, nn.Module]]:
    """Give each leaf of an empty `network` its weights in float32 and hand it out before touching the next.

    The consumer may convert or replace the leaf meanwhile, so that no second copy of the network ever exists. Parts
    that `loaded` declares as drawn get initial weights from `seed`. Raises InputError for weights that do not fit or
    are not finite.
    """
    check(network, loaded)
    for name in leaf_names(network):  # names, not leaves: a list of leaves would keep replaced ones alive
        leaf = network.get_submodule(name)
        if f"{name}.".startswith(loaded.drawn or ("\0",)):
            draw_leaf(network, name, leaf, seed)
        else:
            _fill_leaf(name, leaf, loaded)
        yield name, leaf


def _fill_leaf(name: str, leaf: nn.Module, loaded: LoadedWeights) -> None:
    for key, old in list(leaf.named_parameters(recurse=False)):
        stored = loaded.state[f"{name}.{key}"]
        value = torch.empty(stored.shape, dtype=torch.float32).copy_(stored)  # a copy of our own, off the file's pages
        release_pages(stored)
        if not value.isfinite().all():
            count = int((~value.isfinite()).sum())
            raise InputError(f"{loaded.source}: {name}.{key} holds {count} values that are not finite.")
        setattr(leaf, key, nn.Parameter(value, requires_grad=old.requires_grad))


def _some(keys: list[str]) -> str:
    more = f" and {len(keys) - SHOWN} more" if len(keys) > SHOWN else ""
    return ", ".join(keys[:SHOWN]) + more
