"""Trainer `recolor`: the reference view recoloured, the others as they were, and the truth recoloured everywhere.

A step draws a batch, edits it (`edit_regimes`), simulates what a matcher would say about it (`simulated_matching`),
reconstructs, and compares: pixel by pixel at every step, rendered at every `render_every`-th. All random numbers
follow from (seed, step), so a run that is stopped and resumed gives the weights of one that was not.
"""

from pathlib import Path

import torch
from pydantic import Field
from torch import Tensor

from edit3r.errors import SettingsError
from edit3r.interfaces import LossInputs, Trainer, TrainingJob
from edit3r.training.loop import LoopSettings, Recipe, StepLoss, train
from edit3r.training.processes import Processes
from edit3r.training.schedule import batch_indices, step_generator
from edit3r.types import Cameras, Gaussians
from edit3r_training.batches import TrainingBatch, make_batch
from edit3r_training.edit_regimes import RegimeShares
from edit3r_training.geometric_reference import GeometricReference
from edit3r_training.supervision import colour_error, depth_error, opacity_error, pixel_maps
from edit3r_training.validation import held_out_measures, reconstruct


class RecolorTrainer(Trainer):
    """The paper's second stage, for any pixel-aligned reconstructor with a network."""

    class Settings(LoopSettings):
        batch: int = Field(8, ge=1, le=256, description="scenes a step and process")
        regimes: RegimeShares = Field(RegimeShares(), description="what is edited, how often")
        colour: float = Field(1.0, ge=0, description="weight of the pixel-by-pixel colour error")
        depth: float = Field(1.0, ge=0, description="weight of the pixel-by-pixel depth error")
        opacity: float = Field(0.1, ge=0, description="weight of the pixel-by-pixel opacity error")
        render_every: int = Field(1, ge=0, description="every n-th step also renders, for the job's losses; 0: never")
        render_context: bool = Field(True, description="also render the input views; false: novel views alone")
        drop_first: float = Field(0.5, ge=0, le=1, description="how often the reference's Gaussians are left out")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        return train(RecolorRecipe(self.settings, job), self.settings, job)


class RecolorRecipe(Recipe):
    """Batches, loss and validation of the recolor training."""

    def __init__(self, settings: RecolorTrainer.Settings, job: TrainingJob) -> None:
        if job.reconstructor.network is None:
            raise SettingsError("training.reconstructor: it has no network, so there is nothing to train.")
        super().__init__(job.reconstructor.network)
        self.settings, self.job = settings, job
        self._reference = GeometricReference()

    def begin(self) -> None:
        """Freeze the geometric reference while the network has its start weights."""
        self._reference = GeometricReference.of_start(self.job)

    def loss(self, step: int, processes: Processes) -> StepLoss:
        """The sum of all weighted terms."""
        terms = self._terms(self._batch(step, processes), step)
        return StepLoss(sum(terms.values(), torch.zeros((), device=self.device)), terms)

    def validate(self, step: int, processes: Processes) -> dict[str, float]:
        """Measures of the held-out scenes, and a sheet of images of the first ones."""
        sheet = self.job.out / "sheets" / f"{step:07d}.png" if processes.writes else None
        return held_out_measures(self.job, processes, self.settings.regimes, self.settings.batch, sheet)

    def _batch(self, step: int, processes: Processes) -> TrainingBatch:
        """This process's share of the step's scenes; sample and random numbers do not depend on who draws them."""
        data, size, seed = self.job.train_data, self.settings.batch, self.settings.seed
        indices = batch_indices(step, size, len(data), seed, processes.rank, processes.count)
        generators = [step_generator(seed, step, processes.rank * size + slot) for slot in range(size)]
        batch = make_batch([data[index] for index in indices], self.settings.regimes, generators)
        return batch.to(self.device)

    def _terms(self, batch: TrainingBatch, step: int) -> dict[str, Tensor]:
        """All weighted terms of the objective by name."""
        chosen = self.settings
        reconstruction = reconstruct(self.job, batch)
        maps = pixel_maps(reconstruction, batch.source.count, batch.source.image_size)
        terms = {}
        if chosen.colour:
            terms["colour"] = chosen.colour * colour_error(maps, batch)
        if batch.depths is not None and chosen.depth:
            terms["depth"] = chosen.depth * depth_error(maps, batch)
        if batch.depths is not None and chosen.opacity:
            terms["opacity"] = chosen.opacity * opacity_error(maps, batch)
        if chosen.render_every and step % chosen.render_every == 0:
            terms |= self._rendered_terms(batch, reconstruction.gaussians, step)
        return terms

    def _rendered_terms(self, batch: TrainingBatch, gaussians: Gaussians, step: int) -> dict[str, Tensor]:
        dropped = step_generator(self.settings.seed, step, 1_000_000).random() < self.settings.drop_first
        shown = gaussians.without_view(0) if dropped else gaussians
        first = batch.source.count if not self.settings.render_context else int(dropped)
        cameras, pictures = _seen(batch, first)
        rendered = self.job.rasterizer.render(shown, cameras).images
        inputs = LossInputs(rendered, pictures, gaussians, self._reference(batch, gaussians))
        return {name: weight * loss(inputs) for name, (weight, loss) in self.job.losses.items()}


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
