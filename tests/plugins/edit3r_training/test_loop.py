"""Signals, the log, and a step of the optimiser; the rest is tested with the trainers that use the
loop.
"""

import random
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_training.journal import Journal
from edit3r_training.loop import LoopSettings, Recipe, StepLoss, train
from edit3r_training.stopping import StopRequest
from torch import nn

from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import TrainingJob
from edit3r_testing.training import tiny_job

from .training_kit import log_of


def test_lines_are_json_objects(tmp_path):
    journal = Journal(tmp_path)
    journal.write(1, {"loss": 0.5})
    journal.write(2, {"score": 0.25}, kind="validation")
    lines = log_of(tmp_path)
    assert [line["kind"] for line in lines] == ["train", "validation"]
    assert lines[0]["loss"] == 0.5 and lines[1]["step"] == 2


def test_resuming_takes_out_what_will_be_done_again(tmp_path):
    journal = Journal(tmp_path)
    for step in range(1, 6):
        journal.write(step, {"loss": 0.0})
    journal.path.write_text(
        journal.path.read_text() + 'no line of ours\n[1]\n{"half a li'
    )
    Journal(tmp_path, step=3)
    assert [line["step"] for line in log_of(tmp_path)] == [1, 2, 3]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_noted_and_does_not_interrupt(number):
    with StopRequest() as stop:
        assert not stop.asked
        signal.raise_signal(number)
        assert stop.asked


def test_handlers_are_put_back():
    before = signal.getsignal(signal.SIGINT)
    with StopRequest():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_interrupt_stops_at_once():
    # A shell starts background jobs with SIGINT ignored; "as it would have before" is the interrupt
    # only without that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with StopRequest() as stop, pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
            assert stop.asked
            signal.raise_signal(signal.SIGINT)
            signal.sigtimedwait([], 1)
    finally:
        signal.signal(signal.SIGINT, before)


class _Line(Recipe):
    """Two parts of one weight each, pulled towards the numbers 0, 1, 2, ... of the batches."""

    def __init__(self) -> None:
        one, other = (nn.Linear(1, 1, bias=False) for _ in range(2))
        super().__init__(nn.ModuleDict({"old": one, "new": other}))
        for parameter in self.network.parameters():
            nn.init.zeros_(parameter)
        self.asked: list[int] = []

    def loss(self, step, processes) -> StepLoss:
        self.asked.append(step)
        total = sum(
            -(step + 1) * parameter.sum() for parameter in self.network.parameters()
        )
        return StepLoss(total, {"pull": total})

    def validate(self, step, processes) -> dict[str, float]:
        return {}


def _trained(tmp_path, monkeypatch, **settings):
    """(recipe, learning rates of the groups by step, gradients of the weights by step)."""
    recipe, rates, gradients = _Line(), [], []
    step = torch.optim.AdamW.step

    def spy(optimizer, *args):
        rates.append([group["lr"] for group in optimizer.param_groups])
        gradients.append([float(p.grad) for p in recipe.network.parameters()])
        return step(optimizer, *args)

    monkeypatch.setattr(torch.optim.AdamW, "step", spy)
    job: TrainingJob = tiny_job(tmp_path)
    usual = {"warmup": 1, "clip": 100, "log_every": 1}
    train(recipe, LoopSettings(**usual | settings), job)
    return recipe, rates, gradients


def test_a_step_averages_the_gradients_of_its_batches_and_takes_new_ones(
    tmp_path, monkeypatch
):
    recipe, _, gradients = _trained(tmp_path, monkeypatch, steps=2, accumulate=3)
    assert recipe.asked == [0, 1, 2, 3, 4, 5]
    assert gradients == [[-2, -2], [-5, -5]]
    # the weights began at 0
    assert next(one["pull"] for one in log_of(tmp_path) if one["kind"] == "train") == 0


def test_weights_decay_by_their_share_of_the_rate(tmp_path, monkeypatch):
    """AdamW: each step takes off rate x decay of the weight, besides what the gradient does."""
    ends = []
    for decay in (0.0, 0.5):
        recipe, rates, _ = _trained(
            tmp_path, monkeypatch, steps=2, lr=0.1, weight_decay=decay
        )
        ends.append(recipe.network["new"].weight.item())
    first, second = (rate[0] for rate in rates)
    # The weight begins at 0, and Adam's first step is the rate itself.
    assert ends[0] - ends[1] == pytest.approx(second * 0.5 * first, rel=1e-3)


def test_pretrained_weights_learn_at_their_share_of_the_rate(tmp_path, monkeypatch):
    chosen = {"lr": 0.01, "pretrained": ["old"], "pretrained_rate": 0.1}
    recipe, rates, _ = _trained(tmp_path, monkeypatch, steps=1, **chosen)
    assert rates[0] == pytest.approx([0.01, 0.001])
    new, old = (recipe.network[name].weight.item() for name in ("new", "old"))
    assert new == pytest.approx(10 * old, rel=1e-3)


def test_the_rate_falls_to_the_floor_which_all_weights_share(tmp_path, monkeypatch):
    """As in NoPoSplat: a tenth of the highest rate, where weights at a tenth of it already are and
    stay.
    """
    chosen = {"lr": 0.01, "pretrained": ["old"], "pretrained_rate": 0.1, "floor": 0.1}
    _, rates, _ = _trained(tmp_path, monkeypatch, steps=50, **chosen)
    full, slow = zip(*rates)
    assert full[0] == pytest.approx(0.01) and full[-1] == pytest.approx(0.001, rel=0.02)
    assert list(full[1:]) == sorted(full[1:], reverse=True)
    assert slow == pytest.approx([0.001] * 50)


def test_pretrained_weights_that_do_not_exist_are_an_error_that_lists_those_that_do(
    tmp_path, monkeypatch
):
    with pytest.raises(
        SettingsError, match=r"no weight's name begins with 'trunk'; there are new, old"
    ):
        _trained(tmp_path, monkeypatch, steps=1, pretrained=["trunk"])


class _Interrupted(_Line):
    """Ctrl-C is pressed in batch 3, in the validation of step 4, or while its weights are written.

    The loss draws from all generators that a loss may use.
    """

    def __init__(self, where: str) -> None:
        super().__init__()
        self.where = where

    def loss(self, step, processes) -> StepLoss:
        self._interrupt("batch", step == 2)
        total = super().loss(step, processes).total
        drawn = random.random() + np.random.rand() + torch.rand(())
        return StepLoss(total * drawn, {"drawn": drawn})

    def validate(self, step, processes) -> dict[str, float]:
        self._interrupt("validation", step == 4)
        return {"score": -float(step)}

    def weights_metadata(self) -> dict[str, str]:
        """As the reconstructor: what is asked for when the best weights are written."""
        self._interrupt("files", bool(self.asked))
        return {}

    def _interrupt(self, where: str, now: bool) -> None:
        if now and self.where == where:
            self.where = ""
            signal.raise_signal(signal.SIGINT)
            signal.sigtimedwait([], 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "done"), [("batch", 2), ("validation", 4), ("files", 2)]
)
def test_ctrl_c_leaves_a_step_at_once_and_a_resumed_training_ends_like_a_straight_one(
    tmp_path, where, done
):
    every = {"validate_every": 2, "checkpoint_every": 100, "log_every": 1}
    settings = LoopSettings(warmup=1, steps=6, **every)
    interrupted = _Interrupted(where)
    stopped = tiny_job(tmp_path / "stopped")
    stopped.reconstructor.weights_metadata = interrupted.weights_metadata
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            train(interrupted, settings, stopped)
    finally:
        signal.signal(signal.SIGINT, before)
    last = torch.load(tmp_path / "stopped" / "last.pt", weights_only=True)
    assert last["step"] == done
    resumed, straight = _Interrupted(""), _Interrupted("")
    train(resumed, settings, replace(tiny_job(tmp_path / "stopped"), resume=True))
    train(straight, settings, tiny_job(tmp_path / "straight"))
    assert all(
        torch.equal(a, b)
        for a, b in zip(resumed.network.parameters(), straight.network.parameters())
    )
    left, expected = (
        (
            (tmp_path / name / "best" / "weights.safetensors").read_bytes(),
            [(line["kind"], line["step"]) for line in log_of(tmp_path / name)],
        )
        for name in ("stopped", "straight")
    )
    assert left == expected
