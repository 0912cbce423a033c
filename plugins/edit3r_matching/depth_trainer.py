"""Trainer `depth`: teaches the depth network which plane each cell lies on, from data with depths.

All random numbers follow from (seed, step): a run that is stopped and resumed gives the weights of one that was not.
"""

from collections.abc import Mapping
from pathlib import Path

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.errors import SettingsError
from edit3r.interfaces import Reconstructor, Trainer, TrainingJob
from edit3r.training.checkpoint import WEIGHTS, save_weights
from edit3r.training.loop import LoopSettings, Recipe, StepLoss, train
from edit3r.training.processes import Processes
from edit3r.training.schedule import batch_indices, step_generator
from edit3r_matching.depth_network import LEAST, STRIDE, DepthNetwork
from edit3r_matching.depth_samples import DepthBatch, Wrongness, batch_of

HELD_OUT_SEED = 1 << 20


class DepthTrainer(Trainer):
    """For a reconstructor whose matcher is `classical` with `depth_weights`."""

    class Settings(LoopSettings):
        steps: int = Field(20_000, ge=1, description="optimiser steps")
        batch: int = Field(2, ge=1, le=64, description="views a step")
        lr: float = Field(2e-3, gt=0, le=1, description="highest learning rate")
        warmup: int = Field(100, ge=1, description="steps of linear warm-up")
        weight_decay: float = Field(0.01, ge=0, le=1, description="AdamW's")
        average: float = Field(0.998, ge=0, lt=1, description="decay of the averaged weights, which are kept")
        bfloat16: bool = Field(True, description="compute in bfloat16, which newer processors do twice as fast")
        planes: tuple[int, int] = Field((24, 48), description="least and most depth hypotheses of a step")
        matches: float = Field(2.0, ge=0, description="most noise of the matches that poses are fitted to [pixels]")
        focal: float = Field(0.04, ge=0, le=0.5, description="most relative error of the focal length")
        exposure: float = Field(0.25, ge=0, le=1, description="most change of gain, bias and gamma between views")
        noise: float = Field(0.03, ge=0, le=0.5, description="most noise [sRGB]")
        held_out: int = Field(24, ge=1, description="views of the held-out data that are measured")
        validate_every: int = Field(250, ge=1, description="steps between evaluations on held-out scenes")
        checkpoint_every: int = Field(50, ge=1, description="steps between checkpoints")
        threads: int = Field(1, ge=0, description="CPU threads; 0 leaves torch's choice")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        return train(DepthRecipe(self.settings, job), self.settings, job)


class DepthRecipe(Recipe):
    """Samples, loss and validation of the depth network's training."""

    betas = (0.9, 0.98)

    def __init__(self, settings: DepthTrainer.Settings, job: TrainingJob) -> None:
        super().__init__(trainable_network(job.reconstructor))
        self.settings, self.data, self.held_out = settings, job.train_data, job.validation_data

    def loss(self, step: int, processes: Processes) -> StepLoss:
        """Cross-entropy to the planes that each cell's pixels lie on."""
        chosen = self.settings
        indices = batch_indices(step, chosen.batch, len(self.data), chosen.seed, processes.rank, processes.count)
        batch = self._batch(self.data, indices, step_generator(chosen.seed, step, processes.rank))
        with torch.autocast(self.device.type, torch.bfloat16, enabled=chosen.bfloat16):
            logs = self.network(batch.images, batch.grids, batch.classical)
        return StepLoss(cross_entropy(logs.float(), batch.truth), {})

    def _batch(self, data, indices, rng) -> DepthBatch:
        chosen = self.settings
        how = Wrongness(chosen.matches, chosen.focal, chosen.exposure, chosen.noise)
        batch = batch_of([data[index] for index in indices], rng, how, chosen.planes)
        return DepthBatch(*(value.to(self.device) for value in vars(batch).values()))

    def validate(self, step: int, processes: Processes) -> dict[str, float]:
        """Cross-entropy, and the share of cells whose best plane is within 3 % and 10 %: the network's, and without."""
        rows = []
        for index in range(self.settings.held_out):
            batch = self._batch(self.held_out, [index], step_generator(HELD_OUT_SEED, 0, index))
            logs = self.network(batch.images, batch.grids, batch.classical)
            row = {"score": float(cross_entropy(logs, batch.truth))}
            for name, best in (("", logs.argmax(1)), ("classical_", batch.classical[:, 2].argmin(1))):
                row |= {f"{name}{key}": value for key, value in _right(best, batch).items()}
            rows.append(row)
        values = {name: float(torch.tensor([row[name] for row in rows]).mean()) for name in rows[0]}
        return values | {"sharpness": float(self.network.sharpness)}

    def save_best(self, folder: Path, weights: Mapping[str, Tensor]) -> None:
        """Write the best weights so far, in half precision."""
        save_weights(folder / WEIGHTS, {name: value.half() for name, value in weights.items()})


def cross_entropy(logs: Float[Tensor, "batch plane h w"], truth: Float[Tensor, "batch plane h w"]) -> Float[Tensor, ""]:
    """Mean over the pixels whose depth is within the range."""
    return -(truth * logs.clamp(min=LEAST)).sum() / truth.sum().clamp(min=1)


def _right(best: Tensor, batch: DepthBatch) -> dict[str, float]:
    """Share of the known pixels within 3 and 10 % when each has its cell's plane."""
    inverse = batch.inverse_depths[:, :, None, None].expand(-1, -1, *best.shape[1:]).gather(1, best[:, None])[:, 0]
    inverse = inverse.repeat_interleave(STRIDE, 1).repeat_interleave(STRIDE, 2)
    error = (batch.depth / inverse - 1).abs()[batch.depth.isfinite()]
    return {f"within_{limit}": float((error < limit / 100).float().mean()) for limit in (3, 10)}


def trainable_network(reconstructor: Reconstructor) -> DepthNetwork:
    """The depth network of the reconstructor's matcher; raises SettingsError when it has none."""
    matcher = getattr(reconstructor, "parts", {}).get("matcher")
    network = getattr(matcher, "depth_network", None)
    if not isinstance(network, DepthNetwork):
        raise SettingsError(
            "training.reconstructor: trainer 'depth' teaches the depth network of matcher 'classical'; "
            "set reconstructor: {name: classical, matcher: {name: classical, depth_weights: imagenet-front}}."
        )
    for name, value in network.named_parameters():
        value.requires_grad_(not name.startswith("front."))
    return network
