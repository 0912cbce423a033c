"""Trainer `recolor`: the reference view recoloured, the others as they were, and the truth recoloured everywhere.

A step draws a batch, edits it (`edit_regimes`), simulates what a matcher would say about it (`simulated_matching`),
reconstructs, and compares: pixel by pixel at every step, rendered at every `render_every`-th. All random numbers
follow from (seed, step), so a run that is stopped and resumed gives the weights of one that was not.
"""

from pathlib import Path

import torch
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.errors import MatchingError, SettingsError
from edit3r.interfaces import Dataset, LossInputs, Trainer, TrainingJob
from edit3r.training.checkpoint import LAST, TrainingState, copied_weights
from edit3r.training.journal import Journal
from edit3r.training.processes import Processes, joined_processes, own_device
from edit3r.training.schedule import batch_indices, step_generator, warmup_cosine
from edit3r.training.stopping import StopRequest
from edit3r.types import Cameras, Gaussians
from edit3r_training.batches import TrainingBatch, make_batch
from edit3r_training.edit_regimes import RegimeShares
from edit3r_training.geometric_reference import GeometricReference
from edit3r_training.supervision import (
    colour_error,
    depth_error,
    drop_view,
    opacity_error,
    pixel_maps,
)
from edit3r_training.validation import keep_best, means, reconstruct, validate


class RecolorTrainer(Trainer):
    """The paper's second stage, for any pixel-aligned reconstructor with a network."""

    class Settings(config.Settings):
        steps: int = Field(1000, ge=1, description="optimiser steps")
        batch: int = Field(8, ge=1, le=256, description="scenes a step and process")
        lr: float = Field(1e-3, gt=0, le=1, description="highest learning rate")
        warmup: int = Field(100, ge=1, description="steps of linear warm-up")
        weight_decay: float = Field(0.02, ge=0, le=1, description="AdamW's")
        clip: float = Field(1.0, gt=0, description="largest gradient norm")
        average: float = Field(
            0.999, ge=0, lt=1, description="decay of the averaged weights that are evaluated and kept"
        )
        seed: int = Field(0, ge=0, description="of data order, edits and simulated errors")
        regimes: RegimeShares = Field(RegimeShares(), description="what is edited, how often")
        colour: float = Field(1.0, ge=0, description="weight of the pixel-by-pixel colour error")
        depth: float = Field(1.0, ge=0, description="weight of the pixel-by-pixel depth error")
        opacity: float = Field(0.1, ge=0, description="weight of the pixel-by-pixel opacity error")
        render_every: int = Field(1, ge=0, description="every n-th step also renders, for the job's losses; 0: never")
        render_context: bool = Field(True, description="also render the input views; false: novel views alone")
        drop_first: float = Field(0.5, ge=0, le=1, description="how often the reference's Gaussians are left out")
        validate_every: int = Field(500, ge=1, description="steps between evaluations on held-out scenes")
        checkpoint_every: int = Field(500, ge=1, description="steps between checkpoints")
        log_every: int = Field(20, ge=1, description="steps between log lines")
        device: str = Field("cpu", description="where network and batches live; cuda: every process its own GPU")
        threads: int = Field(0, ge=0, description="CPU threads; 0 leaves torch's choice")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self._reference = GeometricReference()

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        if self.settings.threads:
            torch.set_num_threads(self.settings.threads)
        device = own_device(self.settings.device)
        with joined_processes(device) as processes, StopRequest() as stop:
            if job.reconstructor.network is not None:
                job.reconstructor.network.to(device)
            state = self._state(job, processes)
            journal = Journal(job.out, state.step) if processes.writes else None
            stopped = False
            while state.step < self.settings.steps and not stopped:
                self._step(job, state, journal, processes)
                last, stopped = state.step == self.settings.steps, processes.any(stop.asked)
                if last or state.step % self.settings.validate_every == 0:
                    validate(job, state, journal, processes, self.settings.regimes, self.settings.batch)
                if processes.writes and (last or stopped or state.step % self.settings.checkpoint_every == 0):
                    state.save(job.out / LAST)
                reporting.progress("training", state.step, self.settings.steps)
        if stopped:
            reporting.warn(f"training stopped at step {state.step}; continue with --resume.")
        return job.out / "best"

    def _state(self, job: TrainingJob, processes: Processes) -> TrainingState:
        network = job.reconstructor.network
        if network is None:
            raise SettingsError("training.reconstructor: it has no network, so there is nothing to train.")
        torch.manual_seed(self.settings.seed)
        network.train()
        processes.share_weights(network)
        self._reference = GeometricReference.of_start(job)  # before a resumed run's weights are read
        optimizer = torch.optim.AdamW(
            network.parameters(), lr=self.settings.lr, betas=(0.9, 0.95), weight_decay=self.settings.weight_decay
        )
        state = TrainingState(network, optimizer, copied_weights(network), config=dict(job.config or {}))
        if job.resume:
            state.load(job.out / LAST)
        elif processes.writes:
            keep_best(job.out, state)  # so that there always is one
        return state

    def _step(self, job: TrainingJob, state: TrainingState, journal: Journal | None, processes: Processes) -> None:
        """One optimiser step; one that is not finite is counted and left out."""
        batch = self._batch(job.train_data, state.step, processes)
        for group in state.optimizer.param_groups:
            group["lr"] = self.settings.lr * warmup_cosine(state.step, self.settings.steps, self.settings.warmup)
        state.optimizer.zero_grad(set_to_none=True)
        terms, loss = self._backward(job, batch, state.step)
        loss = processes.average_gradients(state.network.parameters(), loss)
        norm = torch.nn.utils.clip_grad_norm_(state.network.parameters(), self.settings.clip)
        state.step += 1
        learnt = any(parameter.grad is not None for parameter in state.network.parameters())
        if learnt and torch.isfinite(loss) and torch.isfinite(norm):
            state.optimizer.step()
            state.update_average(self.settings.average)
        else:
            state.skipped += 1
            reporting.warn(
                f"step {state.step} was skipped: its loss or gradient is not finite, or nothing could be matched."
            )
        if state.step % self.settings.log_every == 0:
            values = means(processes.gathered([{name: float(term.detach()) for name, term in terms.items()}]))
            if journal is not None:
                line = {"loss": float(loss.detach()), **values, "norm": float(norm), "skipped": state.skipped}
                journal.write(state.step, line)

    def _backward(self, job: TrainingJob, batch: TrainingBatch, step: int) -> tuple[dict[str, Tensor], Tensor]:
        """Terms and their sum, gradients computed; no terms and no gradients for photos that cannot be matched."""
        try:
            terms = self._terms(job, batch, step)
        except MatchingError as error:
            reporting.warn(f"scenes left out of training: {error}")
            return {}, torch.zeros(())
        loss = sum(terms.values())
        loss.backward()
        return terms, loss

    def _batch(self, data: Dataset, step: int, processes: Processes) -> TrainingBatch:
        """This process's share of the step's scenes; sample and random numbers do not depend on who draws them."""
        size, seed = self.settings.batch, self.settings.seed
        indices = batch_indices(step, size, len(data), seed, processes.rank, processes.count)
        generators = [step_generator(seed, step, processes.rank * size + slot) for slot in range(size)]
        batch = make_batch([data[index] for index in indices], self.settings.regimes, generators)
        return batch.to(own_device(self.settings.device))

    def _terms(self, job: TrainingJob, batch: TrainingBatch, step: int) -> dict[str, Tensor]:
        """All weighted terms of the objective by name."""
        chosen = self.settings
        reconstruction = reconstruct(job, batch)
        maps = pixel_maps(reconstruction, batch.source.count, batch.source.image_size)
        terms = {}
        if chosen.colour:
            terms["colour"] = chosen.colour * colour_error(maps, batch)
        if batch.depths is not None and chosen.depth:
            terms["depth"] = chosen.depth * depth_error(maps, batch)
        if batch.depths is not None and chosen.opacity:
            terms["opacity"] = chosen.opacity * opacity_error(maps, batch)
        if chosen.render_every and step % chosen.render_every == 0:
            terms |= self._rendered_terms(job, batch, reconstruction.gaussians, step)
        return terms

    def _rendered_terms(
        self, job: TrainingJob, batch: TrainingBatch, gaussians: Gaussians, step: int
    ) -> dict[str, Tensor]:
        dropped = step_generator(self.settings.seed, step, 1_000_000).random() < self.settings.drop_first
        shown = drop_view(gaussians, 0) if dropped else gaussians
        first = batch.source.count if not self.settings.render_context else int(dropped)
        cameras, pictures = _seen(batch, first)
        rendered = job.rasterizer.render(shown, cameras).images
        inputs = LossInputs(rendered, pictures, gaussians, self._reference(batch, gaussians))
        return {name: weight * loss(inputs) for name, (weight, loss) in job.losses.items()}


def _seen(batch: TrainingBatch, first: int) -> tuple[Cameras, Tensor]:
    """Input views from `first` on and target views; 1 where the reference's Gaussians are left out, whose own picture
    cannot be asked for then."""
    context, target = batch.context_cameras, batch.target_cameras
    cameras = Cameras(
        torch.cat((context.c2w[:, first:], target.c2w), 1),
        torch.cat((context.intrinsics[:, first:], target.intrinsics), 1),
        context.image_size,
    )
    return cameras, torch.cat((batch.truth[:, first:], batch.target), 1)
