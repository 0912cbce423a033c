"""Trainer `geometry`: teaches the matching network matches, depths, confidence and pose from data that knows them.

Nothing is rendered, so a step is cheap. All random numbers follow from (seed, step): a run that is stopped and resumed
gives the weights of one that was not.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from edit3r.errors import SettingsError
from edit3r.interfaces import Reconstructor, Trainer, TrainingJob
from edit3r.training.loop import LoopSettings, Recipe, StepLoss, train
from edit3r.training.processes import Processes
from edit3r.training.schedule import batch_indices, step_generator
from edit3r_matching_network.matcher import NetworkMatcher
from edit3r_matching_network.network import MatchingNetwork, save_network
from edit3r_matching_network.supervision import geometry_terms, match_error, rotation_errors, true_pairs
from edit3r_matching_network.training_pairs import Augmentation, PairMemory, augmented

VALIDATION_SCENES = 64
SHOWN = ("match_median", "within_cell", "depth", "confidence", "coarse", "match")  # in the log of validations


class GeometryTrainer(Trainer):
    """For a reconstructor whose matcher is `network`."""

    class Settings(LoopSettings):
        steps: int = Field(6000, ge=1, description="optimiser steps")
        batch: int = Field(8, ge=1, le=256, description="pairs a step")
        lr: float = Field(1.5e-3, gt=0, le=1, description="highest learning rate")
        warmup: int = Field(200, ge=1, description="steps of linear warm-up")
        weight_decay: float = Field(0.01, ge=0, le=1, description="AdamW's")
        average: float = Field(0.998, ge=0, lt=1, description="decay of the averaged weights, which are kept")
        exposure: float = Field(0.25, ge=0, le=1, description="most change of gain, bias and gamma between views")
        noise: float = Field(0.03, ge=0, le=0.5, description="most noise [sRGB]")
        narrow: float = Field(0.3, ge=0, le=1, description="how often the images lose rows")
        coarse: float = Field(0.15, ge=0, description="weight: cross-entropy of the coarse match")
        corrected: float = Field(0.2, ge=0, description="weight: error of the corrected coarse match [tokens]")
        window: float = Field(0.1, ge=0, description="weight: cross-entropy of the search in the window")
        match: float = Field(0.2, ge=0, description="weight: error of the match [cells]")
        confidence: float = Field(0.2, ge=0, description="weight: cross-entropy of the confidence")
        depth: float = Field(1.0, ge=0, description="weight: error of log depth up to a common scale")
        spread: float = Field(0.05, ge=0, description="weight: likelihood of that error")
        unit: float = Field(0.1, ge=0, description="weight: error of the common scale")
        rotation: float = Field(0.5, ge=0, description="weight: rotation by Procrustes [about radians]")
        translation: float = Field(0.1, ge=0, description="weight: baseline by Procrustes, relative")
        pose_from: int = Field(300, ge=0, description="step from which on the pose counts; before, it is noise")
        checkpoint_every: int = Field(200, ge=1, description="steps between checkpoints")
        log_every: int = Field(50, ge=1, description="steps between log lines")
        threads: int = Field(1, ge=0, description="CPU threads; 0 leaves torch's choice")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        return train(GeometryRecipe(self.settings, job), self.settings, job)


class GeometryRecipe(Recipe):
    """Pairs, loss and validation of the matching network's training."""

    betas = (0.9, 0.98)

    def __init__(self, settings: GeometryTrainer.Settings, job: TrainingJob) -> None:
        super().__init__(trainable_network(job.reconstructor))
        self.settings = settings
        self.pairs = PairMemory(job.train_data)
        self.held_out = None if job.validation_data is None else PairMemory(job.validation_data)

    def loss(self, step: int, processes: Processes) -> StepLoss:
        """The weighted sum of the terms of `geometry_terms`; the log shows them unweighted."""
        chosen = self.settings
        indices = batch_indices(step, chosen.batch, len(self.pairs), chosen.seed, processes.rank, processes.count)
        how = Augmentation(chosen.exposure, chosen.noise, chosen.narrow)
        batch = augmented(self.pairs.batch(indices), how, step_generator(chosen.seed, step, processes.rank))
        batch = batch.to(self.device)
        terms = geometry_terms(self.network(batch.images, batch.intrinsics), batch)
        if step < chosen.pose_from:
            terms = {name: term for name, term in terms.items() if name not in ("rotation", "translation")}
        return StepLoss(sum(getattr(chosen, name) * term for name, term in terms.items()), terms)

    def validate(self, step: int, processes: Processes) -> dict[str, float]:
        """Errors on held-out pairs, the same on every process."""
        return held_out_measures(self.network, self.held_out, self.settings.batch)

    def save_best(self, folder: Path, weights: Mapping[str, Tensor]) -> None:
        """Write the best weights so far with the network's sizes."""
        save_network(folder / "weights.safetensors", weights, self.network.sizes)


def held_out_measures(network: MatchingNetwork, pairs: PairMemory, size: int) -> dict[str, float]:
    """Over the first pairs: errors of match [cells], depth [log] and rotation [degrees]; `score` sums them up."""
    device = next(network.parameters()).device
    count = min(len(pairs), VALIDATION_SCENES)
    rows, turns = [], []
    for start in range(0, count, size):
        batch = pairs.batch(range(start, min(start + size, count))).to(device)
        prediction = network(batch.images, batch.intrinsics)
        truth = true_pairs(batch)
        error = match_error(prediction.coordinates, truth)[truth.visible]
        terms = geometry_terms(prediction, batch)
        terms |= {"match_median": error.median(), "within_cell": (error < 1).float().mean()}
        rows.append({name: float(terms[name]) for name in SHOWN})
        turns.append(rotation_errors(prediction, batch))
    values = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    turns = torch.cat(turns)
    values |= {"rotation_median": float(turns.median()), "rotation_mean": float(turns.mean())}
    return values | {"score": values["match"] + 4 * values["depth"] + 0.1 * values["rotation_median"]}


def trainable_network(reconstructor: Reconstructor) -> MatchingNetwork:
    """The network of the reconstructor's matcher; raises SettingsError when its matcher is another."""
    matcher = getattr(reconstructor, "parts", {}).get("matcher")
    if not isinstance(matcher, NetworkMatcher):
        raise SettingsError(
            "training.reconstructor: trainer 'geometry' teaches the matcher 'network'; "
            "set reconstructor: {name: classical, matcher: {name: network, weights: untrained}}."
        )
    return matcher.matching_network
