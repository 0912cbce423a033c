"""Checkpoints that bring training back exactly: weights, averaged weights, optimiser, step.

They hold tensors and plain values only and are read as such, so that no code of a stranger's file
can run.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from edit3r.contract.errors import InputError, one_line
from edit3r.kit.weights.files import whole_file

LAST = "last.pt"
_NUMBERS = ("step", "skipped", "best", "validated")
_PARTS = {"network", "optimizer", "average", "step", "skipped", "best", "config"}


@dataclass
class TrainingState:
    """All that changes while training; the learning rate and the data order follow from `step`."""

    network: nn.Module
    optimizer: torch.optim.Optimizer
    average: dict[str, Tensor]  # exponential moving average of the weights
    step: int = 0  # steps done
    skipped: int = 0  # steps whose loss or gradient was not finite
    best: float = float("inf")  # lowest validation score so far
    validated: int = 0  # the step of the last validation
    config: dict[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write it under a temporary name, then move it. Raises RunError when the disk is full."""
        content = {
            **{name: getattr(self, name) for name in _NUMBERS},
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "average": self.average,
            "config": json.dumps(self.config, default=str),
        }
        what = f"the checkpoint of step {self.step}"
        then = " and continue with --resume from the one before"
        with whole_file(path, what, then) as partial:
            torch.save(content, partial)

    def load(self, path: Path) -> list[str]:
        """Continue from a checkpoint of the same network and optimiser. Raises InputError.

        Returns what else is set than when it was written, "KEY: BEFORE, now AFTER" each.
        """
        content = _read(path)
        try:
            self.network.load_state_dict(content["network"])
            self.optimizer.load_state_dict(content["optimizer"])
            self.average = {
                name: content["average"][name].to(old.device)
                for name, old in self.average.items()
            }
            self.step, self.skipped = int(content["step"]), int(content["skipped"])
            self.best = float(content["best"])
            self.validated = int(content.get("validated", content["step"]))
            if min(self.step, self.skipped, self.validated) < 0:
                raise ValueError(f"it is at step {self.step}")
            if math.isnan(self.best):
                raise ValueError("its best score is not a number")
        # damaged numbers make whoever gets them raise what they like
        except Exception as error:
            raise InputError(
                f"{path}: made for another network or optimiser ({one_line(error)}); resume with "
                "the configuration that it was trained with, or start again with --overwrite "
                "instead of --resume."
            ) from None
        values = (*self.network.state_dict().values(), *self.average.values())
        if not all(bool(torch.isfinite(one).all()) for one in values):
            raise InputError(
                f"{path}: holds weights that are not finite; start again with --overwrite instead "
                "of --resume."
            )
        return _changes(json.loads(content["config"]), self.config)

    def update_average(self, decay: float) -> None:
        """One step of the moving average, warmed up so that early steps do not linger."""
        decay = min(decay, (1 + self.step) / (10 + self.step))
        for name, tensor in self.network.state_dict().items():
            if tensor.is_floating_point():
                self.average[name].lerp_(tensor.detach(), 1 - decay)
            else:
                self.average[name].copy_(tensor)


def copied_weights(network: nn.Module) -> dict[str, Tensor]:
    """A detached copy of all weights."""
    return {
        name: tensor.detach().clone() for name, tensor in network.state_dict().items()
    }


def _changes(before: Any, after: Any, key: str = "") -> list[str]:
    """What differs between two configurations; where a training lies makes it no other one, nor
    do more steps.
    """
    if isinstance(before, dict) and isinstance(after, dict):
        return [
            change
            for name in {**before, **after}
            for change in _changes(
                before.get(name),
                after.get(name),
                key if name == "settings" else f"{key}.{name}".strip("."),
            )
        ]
    more = key == "trainer.steps" and isinstance(after, int) and after > (before or 0)
    if before == after or key == "out" or more:
        return []
    shown = ["not set" if one is None else json.dumps(one) for one in (before, after)]
    return [f"{key}: {shown[0]}, now {shown[1]}"]


def _read(path: Path) -> dict[str, Any]:
    """The content of a checkpoint, read without running any code that the file may hold."""
    if not path.is_file():
        raise InputError(
            f"{path}: no checkpoint to resume from; start with --overwrite instead of --resume."
        )
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    # a damaged file raises whatever the reader stumbles over
    except Exception as error:
        content, reason = None, type(error).__name__
    else:
        reason = "other content"
    if not isinstance(content, dict) or not _PARTS.issubset(content):
        raise InputError(
            f"{path}: not a complete checkpoint of this version of `edit3r train` ({reason}); "
            "restore it from a copy, or start again with --overwrite instead of --resume."
        )
    return content
