"""What each process of `test_several_processes` does; started by torchrun with a folder for the
results.
"""

import signal
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import torch
import torch.distributed as dist
from edit3r_training.processes import joined_processes
from edit3r_training.recolor_trainer import RecolorTrainer

from edit3r.contract.interfaces import Dataset, TrainingJob
from edit3r_testing.training import tiny_job

STEPS = 4
SHARED = {
    "steps": STEPS,
    "warmup": 2,
    "log_every": 1,
    "validate_every": 2,
    "checkpoint_every": 100,
    "lr": 0.01,
}
REGIMES = {
    "reference": 1,
    "disagreeing": 0,
    "agreeing": 0,
    "unedited": 0,
    "whole_picture": 1,
}


def trainer(batch: int) -> RecolorTrainer:
    """Every scene is edited as a whole, so that each term is a mean over scenes."""
    return RecolorTrainer(
        RecolorTrainer.Settings(batch=batch, regimes=REGIMES, **SHARED)
    )


class StopsItself:
    """Data that asks the process to stop when sample number `at` is drawn."""

    def __init__(self, data, at: int) -> None:
        self.data, self.at, self.asked = data, at, 0

    def __len__(self) -> int:
        return len(self.data)

    at_progress = Dataset.at_progress

    def __getitem__(self, index: int):
        self.asked += 1
        if self.asked == self.at:
            signal.raise_signal(signal.SIGTERM)
        return self.data[index]


def train(job: TrainingJob, name: str, rank: int) -> None:
    """One scene a process, and this process's weights saved."""
    trainer(batch=1).train(job)
    torch.save(job.reconstructor.network.state_dict(), job.out / f"{name}-{rank}.pt")


def main(out: Path) -> None:
    with joined_processes() as processes:
        rank, group = processes.rank, weakref.ref(dist.group.WORLD)
        straight, stopped = tiny_job(out / "straight"), tiny_job(out / "stopped")
        if rank == 1:  # must not matter: the first process's weights count
            torch.nn.init.zeros_(straight.reconstructor.network.weight)
            # only this one is asked
            stopped = replace(stopped, train_data=StopsItself(stopped.train_data, at=2))
        train(straight, "weights", rank)
        train(stopped, "half", rank)
        dist.barrier()
        train(replace(tiny_job(out / "stopped"), resume=True), "weights", rank)
    (out / f"group-{rank}.txt").write_text("gone" if group() is None else "held")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
