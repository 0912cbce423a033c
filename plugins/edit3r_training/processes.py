"""Training on several processes, one a GPU or core group, as `torchrun` starts them.

Every process holds the whole network and its own share of each batch. Gradients are averaged after
each backward pass in one message, so all processes take the same optimiser step; nothing has to
wrap the network, which a reconstructor calls in its own way. One process is the same code with
nothing to send.
"""

import importlib
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.distributed as dist
from torch import Tensor, nn

from edit3r.contract.errors import SettingsError


@dataclass(frozen=True)
class Processes:
    """This process's place among those that train together."""

    rank: int = 0
    count: int = 1

    @property
    def writes(self) -> bool:
        """Whether this one writes checkpoints, logs and images."""
        return self.rank == 0

    def share_weights(self, network: nn.Module) -> None:
        """Give every process the first one's weights and buffers."""
        if self.count > 1:
            for tensor in network.state_dict().values():
                dist.broadcast(tensor, src=0)

    def average_gradients(self, parameters: list[nn.Parameter], loss: Tensor) -> Tensor:
        """Average all gradients in place and return the average loss; both NaN where any process's
        are.

        A parameter that has no gradient on any process keeps none; missing on some, it counts as
        zero there.
        """
        if self.count == 1:
            return loss
        exist = loss.new_tensor([float(p.grad is not None) for p in parameters])
        given = [torch.zeros_like(p) if p.grad is None else p.grad for p in parameters]
        message = torch.cat(
            [*(grad.flatten() for grad in given), exist, loss.detach()[None]]
        )
        dist.all_reduce(message)
        sizes = [*(p.numel() for p in parameters), len(parameters), 1]
        *averaged, with_gradient, mean = (message / self.count).split(sizes)
        for parameter, grad, anywhere in zip(
            parameters, averaged, with_gradient.tolist()
        ):
            parameter.grad = grad.view_as(parameter) if anywhere else None
        return mean[0]

    def gathered(self, rows: list[Any]) -> list[Any]:
        """The lists of all processes joined, first process first; the same everywhere."""
        if self.count == 1:
            return rows
        lists: list[list[Any]] = [[] for _ in range(self.count)]
        dist.all_gather_object(lists, rows)
        return [row for own in lists for row in own]

    def means(self, rows: list[dict[str, float]]) -> dict[str, float]:
        """Mean of each value over the rows of all processes that have any, of the same names."""
        full = [row for row in self.gathered(rows) if row]
        names = full[0] if full else ()
        return {name: float(np.mean([row[name] for row in full])) for name in names}

    def any(self, asked: bool) -> bool:
        """Whether any process says so; all must ask at the same place."""
        return any(self.gathered([asked]))


def own_device(name: str) -> torch.device:
    """The torch device of this name; 'cuda' without a number is this process's own GPU on its
    machine.

    Raises SettingsError when it is not there.
    """
    try:
        device = torch.device(name)
    except RuntimeError:
        raise SettingsError(
            f"trainer.device: no torch device is called {name!r}; expected cpu, cuda or cuda:1."
        ) from None
    if device.type != "cuda":
        return device
    own = int(os.environ.get("LOCAL_RANK", "0"))
    index = own if device.index is None else device.index
    if index >= torch.cuda.device_count():
        raise SettingsError(
            f"trainer.device: cuda:{index} was asked for, but this machine has "
            f"{torch.cuda.device_count()} GPUs."
        )
    return torch.device("cuda", index)


def is_first_process() -> bool:
    """Whether this is the only or first process that torchrun started, before they are joined."""
    return os.environ.get("RANK", "0") == "0"


@contextmanager
def joined_processes(device: torch.device | None = None) -> Iterator[Processes]:
    """The processes that `torchrun` started, or this one alone.

    A group that already stands is used and left standing; else one is formed from torchrun's
    environment (nccl for a `device` that is a GPU, else gloo) and taken down at the end.
    """
    if dist.is_available() and dist.is_initialized():
        yield Processes(dist.get_rank(), dist.get_world_size())
        return
    if int(os.environ.get("WORLD_SIZE", "1")) < 2:
        yield Processes()
        return
    missing = {"RANK", "MASTER_ADDR", "MASTER_PORT"} - os.environ.keys()
    if missing:
        raise SettingsError(
            f"WORLD_SIZE is set but {max(missing)} is not; start several processes with torchrun."
        )
    on_gpu = device is not None and device.type == "cuda"
    if on_gpu:
        torch.cuda.set_device(device)
    # torch.distributed.nn takes the group that stands when it is imported as a default argument and
    # keeps it, with its threads, beyond the end of Python, where they abort the process now and
    # then; imported before, it keeps None.
    importlib.import_module("torch.distributed.nn")
    dist.init_process_group("nccl" if on_gpu else "gloo")
    try:
        yield Processes(dist.get_rank(), dist.get_world_size())
    finally:
        dist.destroy_process_group()
