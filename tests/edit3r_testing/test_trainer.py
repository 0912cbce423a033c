"""The trainer's contract finds every way of breaking it."""

import pytest
import torch

from edit3r.contract.interfaces import Trainer
from edit3r_testing import TrainerContract


class Pretending(Trainer):
    """Moves the weights by a constant instead of training, then answers as told."""

    def __init__(self, folder="last", save=True, move=True, resume=True):
        self.folder, self.save, self.move, self.resume = folder, save, move, resume

    def train(self, job):
        if job.resume and not self.resume:
            raise FileExistsError("the folder exists")
        if self.move:
            with torch.no_grad():
                job.reconstructor.network.weight.add_(0.1)
        folder = job.out / self.folder
        folder.mkdir(parents=True, exist_ok=True)
        if self.save:
            (folder / "weights").write_bytes(b"...")
        return str(folder) if self.folder == "text" else folder


TRAINS, RESUMES = "test_trains_and_returns_the_folder_of_a_checkpoint", "test_resumes"
CASES = {
    "a text": ({"folder": "text"}, TRAINS, "return pathlib.Path, got str"),
    "another place": (
        {"folder": "../elsewhere"},
        TRAINS,
        "of a checkpoint in job.out, got elsewhere",
    ),
    "no checkpoint": ({"save": False}, TRAINS, "of a checkpoint in job.out, got last"),
    "no training": ({"move": False}, TRAINS, "step the optimiser"),
    "no resuming": ({"resume": False}, RESUMES, "raised FileExistsError"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_trainer_broken_by(case, complaint):
    changes, claim, advice = CASES[case]
    assert advice in complaint(TrainerContract, lambda: Pretending(**changes), claim)


def test_every_claim_about_trainers_can_fail():
    own = {name for name in vars(TrainerContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
