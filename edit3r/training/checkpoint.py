"""Checkpoints that bring training back exactly: weights, averaged weights, optimiser, random states, step."""

import os
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from edit3r.errors import InputError, RunError

LAST = "last.pt"
BEST = "best.pt"


@dataclass
class TrainingState:
    """All that changes while training; the learning rate and the data order follow from `step`."""

    network: nn.Module
    optimizer: torch.optim.Optimizer
    average: dict[str, Tensor]  # exponential moving average of the weights
    step: int = 0  # steps done
    skipped: int = 0  # steps whose loss or gradient was not finite
    best: float = float("inf")  # lowest validation score so far
    config: dict[str, Any] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Write under a temporary name and move into place when whole; raises RunError when the disk is full."""
        content = {
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "average": self.average,
            "step": self.step,
            "skipped": self.skipped,
            "best": self.best,
            "config": self.config,
            "random": _random_states(),
        }
        partial = path.with_suffix(".partial")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            torch.save(content, partial)
            os.replace(partial, path)
        except (OSError, RuntimeError) as error:
            partial.unlink(missing_ok=True)
            raise RunError(
                f"{path}: the checkpoint of step {self.step} could not be written ({error}); free some disk space and "
                "continue with --resume from the one before."
            ) from error

    def load(self, path: Path) -> None:
        """Continue from a checkpoint of the same network and optimiser."""
        if not path.is_file():
            raise InputError(f"{path}: no checkpoint to resume from; start without --resume.")
        # Our own file: it holds random states and the configuration besides tensors.
        content = torch.load(path, map_location="cpu", weights_only=False)
        try:
            self.network.load_state_dict(content["network"])
            self.optimizer.load_state_dict(content["optimizer"])
        except (KeyError, RuntimeError, ValueError) as error:
            raise InputError(f"{path}: made for another network or optimiser ({str(error).splitlines()[0]}).") from None
        self.average = {name: tensor.to(self.average[name].device) for name, tensor in content["average"].items()}
        self.step, self.skipped, self.best = content["step"], content["skipped"], content["best"]
        _restore_random_states(content["random"])

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
    return {name: tensor.detach().clone() for name, tensor in network.state_dict().items()}


def _random_states() -> dict[str, Any]:
    return {"python": random.getstate(), "numpy": np.random.get_state(), "torch": torch.get_rng_state()}


def _restore_random_states(states: dict[str, Any]) -> None:
    random.setstate(states["python"])
    np.random.set_state(states["numpy"])
    torch.set_rng_state(states["torch"])
