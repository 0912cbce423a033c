"""Trainer `recolor`: the reference view recoloured, the others as they were, and the truth recoloured everywhere.

A step draws a batch, edits it (`edit_regimes`), simulates what a matcher would say about it (`simulated_matching`),
reconstructs, and compares: pixel by pixel at every step, rendered at every `render_every`-th. All random numbers
follow from (seed, step), so a run that is stopped and resumed gives the weights of one that was not.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import safetensors.torch
import torch
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.errors import RunError, SettingsError
from edit3r.interfaces import Dataset, LossInputs, MatchedGeometry, Trainer, TrainingJob
from edit3r.training.checkpoint import LAST, TrainingState, copied_weights
from edit3r.training.journal import Journal
from edit3r.training.schedule import batch_indices, step_generator, warmup_cosine
from edit3r.training.stopping import StopRequest
from edit3r.types import Cameras, Gaussians, Reconstruction, Views
from edit3r_training.batches import TrainingBatch, make_batch
from edit3r_training.edit_regimes import RegimeShares
from edit3r_training.sample_sheet import save_sample_sheet
from edit3r_training.supervision import (
    colour_error,
    depth_error,
    drop_view,
    measure_edit,
    opacity_error,
    pixel_maps,
)


@runtime_checkable
class GeometryConditioned(Protocol):
    """A reconstructor that can be handed geometry instead of matching photos itself."""

    def from_geometry(self, views: Views, source: Views, geometry: MatchedGeometry) -> Reconstruction: ...


class RecolorTrainer(Trainer):
    """The paper's second stage, for any pixel-aligned reconstructor with a network."""

    class Settings(config.Settings):
        steps: int = Field(1000, ge=1, description="optimiser steps")
        batch: int = Field(8, ge=1, le=256, description="scenes a step")
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
        drop_first: float = Field(0.5, ge=0, le=1, description="how often the reference's Gaussians are left out")
        validate_every: int = Field(500, ge=1, description="steps between evaluations on held-out scenes")
        checkpoint_every: int = Field(500, ge=1, description="steps between checkpoints")
        log_every: int = Field(20, ge=1, description="steps between log lines")
        threads: int = Field(0, ge=0, description="CPU threads; 0 leaves torch's choice")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        if self.settings.threads:
            torch.set_num_threads(self.settings.threads)
        state = self._state(job)
        journal = Journal(job.out, state.step)
        with StopRequest() as stop:
            while state.step < self.settings.steps and not stop.asked:
                self._step(job, state, journal)
                last = state.step == self.settings.steps
                if last or state.step % self.settings.validate_every == 0:
                    self._validate(job, state, journal)
                if last or stop.asked or state.step % self.settings.checkpoint_every == 0:
                    state.save(job.out / LAST)
                reporting.progress("training", state.step, self.settings.steps)
        if stop.asked:
            reporting.warn(f"training stopped at step {state.step}; continue with --resume.")
        return job.out / "best"

    def _state(self, job: TrainingJob) -> TrainingState:
        network = job.reconstructor.network
        if network is None:
            raise SettingsError("training.reconstructor: it has no network, so there is nothing to train.")
        torch.manual_seed(self.settings.seed)
        network.train()
        optimizer = torch.optim.AdamW(
            network.parameters(), lr=self.settings.lr, betas=(0.9, 0.95), weight_decay=self.settings.weight_decay
        )
        state = TrainingState(network, optimizer, copied_weights(network), config=dict(job.config or {}))
        if job.resume:
            state.load(job.out / LAST)
        else:
            _keep_best(job.out, state)  # so that there always is one
        return state

    def _step(self, job: TrainingJob, state: TrainingState, journal: Journal) -> None:
        """One optimiser step; one that is not finite is counted and left out."""
        batch = self._batch(job.train_data, state.step, self.settings.seed)
        for group in state.optimizer.param_groups:
            group["lr"] = self.settings.lr * warmup_cosine(state.step, self.settings.steps, self.settings.warmup)
        terms = self._terms(job, batch, state.step)
        loss = sum(terms.values())
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(state.network.parameters(), self.settings.clip)
        state.step += 1
        if torch.isfinite(loss) and torch.isfinite(norm):
            state.optimizer.step()
            state.update_average(self.settings.average)
        else:
            state.skipped += 1
            reporting.warn(f"step {state.step} was skipped: its loss or gradient is not finite.")
        if state.step % self.settings.log_every == 0:
            values = {name: float(term.detach()) for name, term in terms.items()}
            journal.write(
                state.step, {"loss": float(loss.detach()), **values, "norm": float(norm), "skipped": state.skipped}
            )

    def _batch(self, data: Dataset, step: int, seed: int) -> TrainingBatch:
        indices = batch_indices(step, self.settings.batch, len(data), seed)
        generators = [step_generator(seed, step, slot) for slot in range(len(indices))]
        return make_batch([data[index] for index in indices], self.settings.regimes, generators)

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
        cameras, pictures = _seen(batch, with_reference=not dropped)
        rendered = job.rasterizer.render(shown, cameras).images
        inputs = LossInputs(rendered, pictures, gaussians, _reference(batch, gaussians))
        return {name: weight * loss(inputs) for name, (weight, loss) in job.losses.items()}

    @torch.no_grad()
    def _validate(self, job: TrainingJob, state: TrainingState, journal: Journal) -> None:
        """Measure the averaged weights on held-out scenes, save a sheet, keep the best."""
        if job.validation_data is None:
            _keep_best(job.out, state)
            return
        with averaged_weights(state):
            batches = self._validation_batches(job.validation_data)
            answers = [(batch, reconstruct(job, batch)) for batch in batches]
        maps = [(pixel_maps(r, b.source.count, b.source.image_size), b) for b, r in answers]
        values = _means([_measured(m, b) for m, b in maps])
        journal.write(state.step, values, kind="validation")
        save_sample_sheet(job.out / "sheets" / f"{state.step:07d}.png", *maps[0])
        if values["score"] < state.best:
            state.best = values["score"]
            _keep_best(job.out, state)

    def _validation_batches(self, data: Dataset) -> list[TrainingBatch]:
        """The first scenes, at most 64, with the same edits and errors every time."""
        size = min(self.settings.batch, len(data))
        batches = []
        for start in range(0, min(len(data), 64) // size * size, size):
            generators = [step_generator(987_654_321, 0, start + slot) for slot in range(size)]
            samples = [data[start + slot] for slot in range(size)]
            batches.append(make_batch(samples, self.settings.regimes, generators))
        return batches


def reconstruct(job: TrainingJob, batch: TrainingBatch) -> Reconstruction:
    """With the batch's simulated matching where the reconstructor takes geometry, else from the pictures alone."""
    reconstructor = job.reconstructor
    if batch.geometry is not None and isinstance(reconstructor, GeometryConditioned):
        return reconstructor.from_geometry(batch.edited, batch.source, batch.geometry)
    return reconstructor(batch.edited, batch.source)


class averaged_weights:
    """Context manager: the network carries its averaged weights inside."""

    def __init__(self, state: TrainingState) -> None:
        self.state = state

    def __enter__(self) -> None:
        self._own = copied_weights(self.state.network)
        self.state.network.load_state_dict(self.state.average)
        self.state.network.eval()

    def __exit__(self, *error: object) -> None:
        self.state.network.load_state_dict(self._own)
        self.state.network.train()


def _seen(batch: TrainingBatch, with_reference: bool) -> tuple[Cameras, Tensor]:
    """Target views and context views; without the reference's Gaussians its own picture cannot be asked for."""
    first = 0 if with_reference else 1
    context, target = batch.context_cameras, batch.target_cameras
    cameras = Cameras(
        torch.cat((context.c2w[:, first:], target.c2w), 1),
        torch.cat((context.intrinsics[:, first:], target.intrinsics), 1),
        context.image_size,
    )
    return cameras, torch.cat((batch.truth[:, first:], batch.target), 1)


def _reference(batch: TrainingBatch, gaussians: Gaussians) -> Gaussians | None:
    """The prediction moved onto the true surface: what the geometry losses pull towards."""
    centres = batch.true_centres()
    if centres is None or centres.shape != gaussians.means.shape:
        return None
    return Gaussians(
        centres,
        gaussians.scales.detach(),
        gaussians.quats.detach(),
        gaussians.opacities.detach(),
        gaussians.harmonics.detach(),
        gaussians.view_index,
    )


def _measured(maps, batch: TrainingBatch) -> dict[str, float]:
    measures = measure_edit(maps, batch)
    colour = float(colour_error(maps, batch))
    values = {"colour": colour, **vars(measures)}
    values["score"] = colour + (float(depth_error(maps, batch)) if batch.depths is not None else 0.0)
    return values


def _means(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def _keep_best(out: Path, state: TrainingState) -> None:
    """Write the averaged weights to `best/`, whole or not at all."""
    folder = out / "best"
    partial = folder / "weights.partial"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        safetensors.torch.save_file({k: v.contiguous() for k, v in state.average.items()}, partial)
        partial.replace(folder / "weights.safetensors")
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise RunError(f"{folder}: the best weights could not be written ({error}); free some disk space.") from error
