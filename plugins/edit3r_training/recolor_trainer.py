"""Trainer `recolor`: the reference view recoloured, the others as they were, and the truth
recoloured everywhere.

A step draws a batch, edits it (`asymmetric_inputs`), simulates what a matcher would say of it
(`simulated_matching`), reconstructs, and compares: pixel by pixel at every step
(`gaussian_errors`), rendered at every `render_every`-th.

With nothing edited, novel views alone rendered and `unit: baseline` it is the first stage too,
NoPoSplat's training.
"""

import copy
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import LossInputs, SceneSample, Trainer, TrainingJob
from edit3r.contract.settings import Index, NonNegative, Share
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering
from edit3r.kit import asking
from edit3r.kit.reconstructing import WithMatcher
from edit3r_training.asymmetric_inputs import RegimeShares
from edit3r_training.batches import TrainingBatch, Unit, make_batch
from edit3r_training.gaussian_errors import (
    colour_error,
    depth_error,
    opacity_error,
    pixel_maps,
)
from edit3r_training.loop import LoopSettings, Recipe, StepLoss, train
from edit3r_training.processes import Processes
from edit3r_training.schedule import batch_indices, step_generator
from edit3r_training.simulated_matching import (
    SimulatedMatch,
    really_match,
    simulate_match,
)
from edit3r_training.validation import held_out_batches, held_out_measures, reconstruct


class RecolorTrainer(Trainer):
    """The paper's training, for any network that gives every pixel its own Gaussian."""

    class Settings(LoopSettings):
        batch: int = Field(8, ge=1, le=256)
        """scenes a step and process"""
        regimes: RegimeShares = RegimeShares()
        """what is edited, how often"""
        colour: NonNegative = 1.0
        """weight of the pixel-by-pixel colour error"""
        depth: NonNegative = 1.0
        """weight of the pixel-by-pixel depth error"""
        opacity: NonNegative = 0.1
        """weight of the pixel-by-pixel opacity error"""
        render_every: Index = 1
        """every n-th step also renders, for the job's losses; 0: never"""
        render_context: bool = True
        """also render the input views; false: novel views alone"""
        drop_first: Share = 0.5
        """how often the reference's Gaussians are left out"""
        unit: Unit = "matcher"
        """unit of length: any, as in a simulated matching; baseline: first to last input camera,
        which a network that sees images alone can tell
        """
        matched: Share = 0.0
        """share of the geometry that is matched, not simulated"""
        precision: Literal["float32", "bfloat16"] = "float32"
        """of the network's products; weights, renderings and losses stay float32"""
        workers: int = Field(0, ge=0, le=64)
        """threads that load the next batch's samples meanwhile; 0: when they are needed"""
        score: Literal["pixels", "renderings"] = "pixels"
        """what makes the best weights: errors pixel by pixel, or of rendered novel views"""

    settings: Settings

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        return train(RecolorRecipe(self.settings, job), self.settings, job)


class RecolorRecipe(Recipe):
    """Batches, loss and validation of the recolor training."""

    def __init__(self, settings: RecolorTrainer.Settings, job: TrainingJob) -> None:
        if job.reconstructor.network is None:
            raise SettingsError(
                "training.reconstructor: it has no network, so there is nothing to train."
            )
        super().__init__(job.reconstructor.network)
        self.settings = settings
        self.job = job
        self._reference = GeometricReference()
        # By sample, where really matched.
        self._matches: dict[str, SimulatedMatch | None] = {}
        workers = settings.workers
        self._loader = ThreadPoolExecutor(workers) if workers else None
        # Samples being loaded, by step.
        self._ahead: dict[int, list[Future[SceneSample]]] = {}

    def begin(self) -> None:
        """Freeze the geometric reference while the network has its start weights."""
        self._reference = GeometricReference.of_start(self.job)

    def loss(self, step: int, processes: Processes) -> StepLoss:
        """The sum of all weighted terms."""
        terms = self._terms(self._batch(step, processes), step)
        return StepLoss(sum(terms.values(), torch.zeros((), device=self.device)), terms)

    def validate(self, step: int, processes: Processes) -> dict[str, float]:
        """Measures of the held-out scenes, and a sheet of images of the first ones."""
        sheet = self.job.out / "sheets" / f"{step:07d}.png"
        chosen, data = self.settings, self.job.validation_data
        assert data is not None  # the loop has asked
        how = chosen.regimes, chosen.batch, chosen.unit, self._match
        batches, rendered = held_out_batches(data, *how), chosen.score == "renderings"
        shown = sheet if processes.writes else None
        return held_out_measures(self.job, processes, batches, rendered, shown)

    def _batch(self, step: int, processes: Processes) -> TrainingBatch:
        """This process's share of the step's scenes, whoever draws them."""
        chosen = self.settings
        first = processes.rank * chosen.batch
        slots = range(first, first + chosen.batch)
        generators = [step_generator(chosen.seed, step, slot) for slot in slots]
        samples = self._samples(step, processes)
        how = chosen.regimes, generators, chosen.unit, self._match
        return make_batch(samples, *how).to(self.device)

    def _match(self, sample: SceneSample, rng: np.random.Generator) -> SimulatedMatch:
        """What is said of a sample's geometry: now and then the matcher's, if it places all."""
        # No draw where nothing is matched: recipes without it keep their random numbers.
        if not self.settings.matched or rng.random() >= self.settings.matched:
            return simulate_match(sample, rng)
        if sample.name not in self._matches:
            self._matches[sample.name] = really_match(sample, self.job.matcher)
        return self._matches[sample.name] or simulate_match(sample, rng)

    def _samples(self, step: int, processes: Processes) -> list[SceneSample]:
        """The samples of a step; with workers, those of the next are begun."""
        if self._loader is None:
            return [self._sample(*one) for one in self._wanted(step, processes)]
        for near in (step, step + 1):
            if near not in self._ahead:
                # What a worker warns of is collected as if it were loaded here.
                self._ahead[near] = [
                    self._loader.submit(partial(copy_context().run, self._sample, *one))
                    for one in self._wanted(near, processes)
                ]
        return [future.result() for future in self._ahead.pop(step)]

    def _wanted(self, step: int, processes: Processes) -> list[tuple[int, int]]:
        """(index, step) of every sample of a step."""
        chosen, place = self.settings, (processes.rank, processes.count)
        length = len(self.job.train_data)
        indices = batch_indices(step, chosen.batch, length, chosen.seed, *place)
        return [(index, step) for index in indices]

    def _sample(self, index: int, step: int) -> SceneSample:
        """One sample, as hard as it should be at that step."""
        steps = self.settings.steps * self.settings.accumulate
        data = self.job.train_data
        return asking.sample(data, lambda: data.at_progress(index, step / steps))

    def _terms(self, batch: TrainingBatch, step: int) -> dict[str, Tensor]:
        """All weighted terms of the objective by name."""
        chosen = self.settings
        half = chosen.precision == "bfloat16"
        with torch.autocast(self.device.type, torch.bfloat16, enabled=half):
            reconstruction = reconstruct(self.job, batch)
        terms = self._pixel_terms(batch, reconstruction)
        if chosen.render_every and step % chosen.render_every == 0:
            terms |= self._rendered_terms(batch, reconstruction, step)
        return terms

    def _pixel_terms(
        self, batch: TrainingBatch, reconstruction: Reconstruction
    ) -> dict[str, Tensor]:
        """The weighted errors of every pixel's own Gaussian."""
        chosen = self.settings
        errors = {"colour": colour_error}
        if batch.depths is not None:
            errors |= {"depth": depth_error, "opacity": opacity_error}
        weights = {name: getattr(chosen, name) for name in errors}
        if not any(weights.values()):
            return {}
        maps = pixel_maps(reconstruction, batch.context_cameras)
        counted = {name: weight for name, weight in weights.items() if weight}
        return {name: w * errors[name](maps, batch) for name, w in counted.items()}

    def _rendered_terms(
        self, batch: TrainingBatch, reconstruction: Reconstruction, step: int
    ) -> dict[str, Tensor]:
        """The job's losses of rendered views.

        First-view drop (section 4.4): now and then without the reference's Gaussians, so that the
        others have to show the edit; the reference's own view cannot be asked for then.
        """
        chosen, gaussians = self.settings, reconstruction.gaussians
        draw = step_generator(chosen.seed, step, 1_000_000).random()
        dropped = draw < chosen.drop_first
        shown = gaussians.without_view(0) if dropped else gaussians
        first = int(dropped) if chosen.render_context else batch.source.count
        cameras, wished, depths = _supervised_views(batch, first)
        drawn = asking.render(self.job.rasterizer, shown, cameras)

        def render(wanted: Cameras) -> Rendering:
            if wanted is cameras:
                return drawn
            return asking.render(self.job.rasterizer, shown, wanted)

        inputs = LossInputs(
            rendered=drawn.images,
            target=wished,
            gaussians=gaussians,
            reference=self._reference(batch, reconstruction),
            cameras=cameras,
            depths=depths,
            render=render,
            geometry=batch.geometry,
        )
        return {
            name: weight * asking.loss(loss, inputs)
            for name, (weight, loss) in self.job.losses.items()
        }


def _supervised_views(
    batch: TrainingBatch, first: int
) -> tuple[
    Cameras,
    Float[Tensor, "batch view 3 height width"],
    Float[Tensor, "batch view height width"] | None,
]:
    """Cameras, wished images and true depths of the context views from `first` on and of the target
    views, whose depths nobody knows.
    """
    context, target = batch.context_cameras, batch.target_cameras
    kept = context.select(range(first, context.count))
    cameras = Cameras(
        torch.cat((kept.c2w, target.c2w), 1),
        torch.cat((kept.intrinsics, target.intrinsics), 1),
        context.image_size,
    )
    wished = torch.cat((batch.truth[:, first:], batch.target), 1)
    if batch.depths is None:
        return cameras, wished, None
    depths = wished.new_zeros(*wished.shape[:2], *wished.shape[3:])
    known = batch.depths[:, first:]
    if batch.reshaped is not None:
        known = known * ~batch.reshaped[:, first:]
    depths[:, : known.shape[1]] = known
    return cameras, wished, depths


class GeometricReference:
    """What the 3D losses hold the edited Gaussians to (section 3.3): G_ref, the geometry of the
    unedited photos.

    It is what a frozen model makes of the photos: the job's reference, else the network as it is at
    the start. Without a reference it is the true surface where the data has depths. Where a
    generated edit added or removed things, it holds to nothing.
    """

    def __init__(self, frozen: WithMatcher | None = None) -> None:
        self.frozen = frozen

    @staticmethod
    def of_start(job: TrainingJob) -> "GeometricReference":
        """The job's reference, frozen, or a copy of the network where losses need one."""
        frozen, data = job.reference, job.train_data
        if frozen is None and job.losses:
            first = asking.sample(data, partial(data.__getitem__, 0))
            if first.context_depths is None:
                frozen = copy.deepcopy(job.reconstructor)
        if frozen is not None and frozen.network is not None:
            network = job.reconstructor.network
            assert network is not None  # the recipe has asked
            device = next(network.parameters()).device
            frozen.network.eval().requires_grad_(False).to(device)
        if frozen is None:
            return GeometricReference()
        return GeometricReference(WithMatcher(frozen, job.matcher))

    @torch.no_grad()
    def __call__(
        self, batch: TrainingBatch, reconstruction: Reconstruction
    ) -> Gaussians | None:
        """Reference Gaussians, one for each predicted; None when there are none."""
        gaussians, each = reconstruction.gaussians, reconstruction.per_pixel
        if self.frozen is None:
            centres = batch.true_centres()
            if centres is not None:
                centres = centres.repeat_interleave(each, 1)
        else:
            centres = self.frozen(batch.source, batch.source).gaussians.means
        if centres is None or centres.shape != gaussians.means.shape:
            return None
        return replace(
            gaussians, means=_free_where_reshaped(centres, batch, reconstruction)
        )


def _free_where_reshaped(
    centres: Float[Tensor, "batch gaussian 3"],
    batch: TrainingBatch,
    reconstruction: Reconstruction,
) -> Float[Tensor, "batch gaussian 3"]:
    """The reference's centres where the edit left the surface; elsewhere the predicted ones."""
    if batch.reshaped is None:
        return centres
    free = batch.reshaped.flatten(1).repeat_interleave(reconstruction.per_pixel, 1)[
        ..., None
    ]
    return torch.where(free, reconstruction.gaussians.means.detach(), centres)
