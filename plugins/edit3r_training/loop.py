"""The training loop that every trainer shares: a trainer brings a recipe, the loop does the rest.

The rest is: the learning-rate schedule, gradient clipping, averaged weights, steps that are not
finite, several processes, the log, checkpoints, resuming, stopping at a signal, validation, and the
best weights. Data and random numbers of a batch are functions of the seed and its number, so a
resumed run gives exactly the weights of a straight one.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from edit3r.contract import reporting
from edit3r.contract.errors import MatchingError, PluginError, SettingsError
from edit3r.contract.interfaces import TrainingJob
from edit3r.contract.settings import Count, Index, Settings, Share
from edit3r.kit.weights.files import WEIGHTS, save_weights
from edit3r_training.checkpoint import LAST, TrainingState, copied_weights
from edit3r_training.journal import Journal
from edit3r_training.processes import Processes, joined_processes, own_device
from edit3r_training.schedule import seed_everything, warmup_cosine
from edit3r_training.stopping import StopRequest


class LoopSettings(Settings):
    """The loop's settings; a trainer's derive from these and may give other defaults."""

    steps: Count = 1000
    """optimiser steps"""
    lr: float = Field(1e-3, gt=0, le=1)
    """highest learning rate"""
    warmup: Count = 100
    """steps of linear warm-up"""
    floor: Share = 0.05
    """learning rate at the last step, as a share of the highest"""
    pretrained: tuple[str, ...] = ()
    """beginnings of the names of weights that learn more slowly, such as backbone.encoder"""
    pretrained_rate: float = Field(0.1, gt=0, le=1)
    """their share of the highest learning rate"""
    accumulate: Count = 1
    """batches a step, one after the other; their gradients are averaged"""
    weight_decay: Share = 0.02
    """AdamW's"""
    clip: float = Field(1.0, gt=0)
    """largest gradient norm"""
    average: float = Field(0.999, ge=0, lt=1)
    """decay of the averaged weights that are evaluated and kept"""
    seed: Index = 0
    """of data order and all random choices"""
    validate_every: Count = 500
    """steps between evaluations on held-out scenes"""
    checkpoint_every: Count = 500
    """steps between checkpoints"""
    log_every: Count = 20
    """steps between log lines"""
    device: str = "cpu"
    """where network and batches live; cuda: every process its own GPU"""
    threads: Index = 0
    """CPU threads; 0 leaves torch's choice"""


@dataclass(frozen=True)
class StepLoss:
    """The loss of one step and the terms that the log shows."""

    total: Float[Tensor, ""]  # what the gradient is taken of
    terms: Mapping[str, Tensor]  # scalars by name


class Recipe(ABC):
    """What one training has of its own: a network, a loss and a validation."""

    betas: ClassVar[tuple[float, float]] = (0.9, 0.95)  # AdamW's

    def __init__(self, network: nn.Module) -> None:
        self.network = network  # trained in place

    @property
    def device(self) -> torch.device:
        """Where the network is, and where its data must go."""
        return next(self.network.parameters()).device

    def begin(self) -> None:  # noqa: B027 - optional
        """Prepare for the first step; the network has its start weights on all processes."""

    @abstractmethod
    def loss(self, step: int, processes: Processes) -> StepLoss:
        """The loss of this process's share of a batch; `step` counts batches from 0, `accumulate`
        of them a step.

        The random numbers of torch, numpy and Python follow from seed, batch and process. Raises
        MatchingError when nothing can be learnt from the data; the step is then skipped.
        """

    @abstractmethod
    def validate(self, step: int, processes: Processes) -> dict[str, float]:
        """Measure the network on held-out scenes; the same values on all processes, empty when
        nothing was measured.

        `score` (lower is better) decides about the best weights. The network has its averaged
        weights meanwhile.
        """


def train(recipe: Recipe, settings: LoopSettings, job: TrainingJob) -> Path:
    """Train to the last step or until asked to stop; returns the folder of the best weights.

    After Ctrl-C the last whole step is saved and KeyboardInterrupt raised. One process leaves its
    step at once for that; several, who wait for each other in every step, and SIGTERM end the step
    first.
    """
    if settings.threads:
        torch.set_num_threads(settings.threads)
    device = own_device(settings.device)
    with (
        joined_processes(device) as processes,
        StopRequest(at_once=processes.count == 1) as stop,
    ):
        recipe.network.to(device)
        _Loop(recipe, settings, job, processes, stop).run()
    return job.out / "best"


class _Loop:
    """One training: its state, its log and its steps."""

    def __init__(
        self,
        recipe: Recipe,
        settings: LoopSettings,
        job: TrainingJob,
        processes: Processes,
        stop: StopRequest,
    ) -> None:
        self.recipe = recipe
        self.settings = settings
        self.job = job
        self.processes = processes
        self.stop = stop
        self.changes: list[str] = []  # of the settings, in a training that goes on
        self.state = self._start()
        self.journal = Journal(job.out, self.state.step) if processes.writes else None
        if self.changes:
            reporting.warn(
                f"resumed at step {self.state.step} with other settings than before: "
                f"{'; '.join(self.changes)}."
            )
            if self.journal is not None:
                self.journal.tell_changes(self.state.step, self.changes)

    def _start(self) -> TrainingState:
        """The first state, or that of the last checkpoint."""
        network, last = self.recipe.network, self.job.out / LAST
        network.train()
        self.processes.share_weights(network)
        self.recipe.begin()  # before a resumed run's weights are read
        groups = parameter_groups(network, self.settings)
        self.rates = [rate for rate, _ in groups]
        optimizer = torch.optim.AdamW(
            [{"params": parameters} for _, parameters in groups],
            lr=self.settings.lr,
            betas=self.recipe.betas,
            weight_decay=self.settings.weight_decay,
        )
        config = dict(self.job.config or {})
        state = TrainingState(
            network, optimizer, copied_weights(network), config=config
        )
        if self.job.resume:
            self.changes = state.load(last)
        elif self.processes.writes:
            # Another training's, which --resume must not take for this one's.
            last.unlink(missing_ok=True)
            self._save_best(state)  # so that there always is one
        return state

    def run(self) -> None:
        """All steps that are left, with their validations and checkpoints."""
        chosen, state = self.settings, self.state
        try:
            if self._is_due(chosen.validate_every) and state.validated < state.step:
                self._validate()  # what an interrupt kept from being done
            stopped = False
            while state.step < chosen.steps and not stopped:
                self._step()
                stopped = self.processes.any(self.stop.asked)
                if self._is_due(chosen.validate_every):
                    self._validate()
                if stopped or self._is_due(chosen.checkpoint_every):
                    self._save()
                reporting.progress("training", state.step, chosen.steps)
            if stopped and state.step < chosen.steps:
                self._tell_stopped()
        except KeyboardInterrupt:
            self._save()
            self._tell_stopped()
            raise
        if self.stop.interrupted:
            raise KeyboardInterrupt

    def _is_due(self, every: int) -> bool:
        """Whether what happens every so many steps, and after the last, happens now."""
        step = self.state.step
        return step > 0 and (step % every == 0 or step == self.settings.steps)

    def _tell_stopped(self) -> None:
        reporting.warn(
            f"training stopped at step {self.state.step}; continue with --resume."
        )

    def _save(self) -> None:
        if self.processes.writes:
            with self.stop.held():
                self.state.save(self.job.out / LAST)

    def _save_best(self, state: TrainingState) -> None:
        metadata = self.job.reconstructor.weights_metadata()
        save_weights(self.job.out / "best" / WEIGHTS, state.average, metadata)

    def _step(self) -> None:
        """One optimiser step; one that is not finite is counted and left out."""
        chosen, state = self.settings, self.state
        parameters = list(state.network.parameters())
        self._set_rates()
        state.optimizer.zero_grad(set_to_none=True)
        loss = self._backward()
        total = self.processes.average_gradients(parameters, loss.total)
        norm = torch.nn.utils.clip_grad_norm_(parameters, chosen.clip)
        learnt = any(parameter.grad is not None for parameter in parameters)
        with self.stop.held():  # a step is done whole or not at all
            state.step += 1
            if learnt and torch.isfinite(total) and torch.isfinite(norm):
                state.optimizer.step()
                state.update_average(chosen.average)
            else:
                state.skipped += 1
                why = _why_skipped(loss.terms, total, learnt)
                reporting.warn(f"step {state.step} was skipped: {why}.")
        if state.step % chosen.log_every == 0:
            self._log(total, loss.terms, norm)

    def _set_rates(self) -> None:
        """The step's learning rates: groups fall from shares of the highest to one lowest."""
        chosen = self.settings
        for group, rate in zip(self.state.optimizer.param_groups, self.rates):
            floor = min(1.0, chosen.floor / rate)
            factor = warmup_cosine(self.state.step, chosen.steps, chosen.warmup, floor)
            group["lr"] = chosen.lr * rate * factor

    def _backward(self) -> StepLoss:
        """The mean loss of the step's batches, gradients computed."""
        count = self.settings.accumulate
        total = torch.zeros((), device=self.recipe.device)
        terms: dict[str, Tensor] = {}
        for batch in range(self.state.step * count, (self.state.step + 1) * count):
            loss = self._backward_of(batch)
            total = total + loss.total.detach() / count
            for name, term in loss.terms.items():
                terms[name] = terms.get(name, 0) + term.detach() / count
        return StepLoss(total, terms)

    def _backward_of(self, batch: int) -> StepLoss:
        """One batch's loss, gradients added; zero and none for photos that cannot be matched."""
        seed_everything(self.settings.seed, batch, self.processes.rank)
        try:
            loss = self.recipe.loss(batch, self.processes)
        except MatchingError as error:
            reporting.warn(f"scenes left out of training: {error}")
            return StepLoss(torch.zeros((), device=self.recipe.device), {})
        if not loss.total.requires_grad:
            raise PluginError(
                f"training: the loss of step {self.state.step + 1} does not depend on the "
                "network's weights; give a term a weight, and let the reconstructor compute with "
                "gradients (no torch.no_grad)."
            )
        (loss.total / self.settings.accumulate).backward()
        return loss

    def _log(self, total: Tensor, terms: Mapping[str, Tensor], norm: Tensor) -> None:
        own = {name: float(term) for name, term in terms.items()}
        values = {"loss": float(total), **self.processes.means([own])}
        if self.journal is not None:
            line = {**values, "norm": float(norm), "skipped": self.state.skipped}
            self.journal.write(self.state.step, line)

    def _validate(self) -> None:
        """Measure averaged weights on held-out scenes and keep the best; without such, the last."""
        state, improved, score = self.state, True, float("inf")
        if self.job.validation_data is not None:
            with torch.no_grad(), _averaged_weights(state, self.stop):
                values = self.recipe.validate(state.step, self.processes)
            score = values.get("score", score)
            improved = score < state.best
            if values and self.journal is not None:
                self.journal.write(state.step, values, kind="validation")
        with self.stop.held():
            if improved and self.processes.writes:
                self._save_best(state)
            state.best = min(state.best, score)
            state.validated = state.step


def parameter_groups(
    network: nn.Module, settings: LoopSettings
) -> list[tuple[float, list[nn.Parameter]]]:
    """Return (share of the learning rate, weights) of what learns at full rate, then of what was
    trained before.

    Raises SettingsError for a beginning in `settings.pretrained` that no weight's name has.
    """
    every = network.named_parameters()
    named = {name: value for name, value in every if value.requires_grad}
    for beginning in settings.pretrained:
        if not any(name.startswith(beginning) for name in named):
            groups = {name.rsplit(".", 1)[0].split(".0", 1)[0] for name in named}
            raise SettingsError(
                f"trainer.pretrained: no weight's name begins with {beginning!r}; there are "
                f"{', '.join(sorted(groups)[:12])}."
            )
    full: list[nn.Parameter] = []
    slow: list[nn.Parameter] = []
    for name, value in named.items():
        (slow if name.startswith(settings.pretrained) else full).append(value)
    shares = [(1.0, full), (settings.pretrained_rate, slow)]
    return [(rate, values) for rate, values in shares if values]


def _why_skipped(terms: Mapping[str, Tensor], total: Tensor, learnt: bool) -> str:
    """Why no weight was changed: `terms` are this process's, `total` is the mean over all."""
    broken = [name for name, term in terms.items() if not torch.isfinite(term)]
    if broken:
        values = (f"{name!r} is {float(terms[name])}" for name in broken)
        return f"its loss {' and '.join(values)}"
    if not torch.isfinite(total):
        return "the loss of another process is not finite"
    if learnt:
        return "its loss is finite, its gradient is not"
    return "nothing could be matched"


@contextmanager
def _averaged_weights(state: TrainingState, stop: StopRequest) -> Iterator[None]:
    """The network carries its averaged weights inside, for evaluation."""
    own = copied_weights(state.network)
    try:
        state.network.load_state_dict(state.average)
        state.network.eval()
        yield
    finally:
        with stop.held():
            state.network.load_state_dict(own)
            state.network.train()
