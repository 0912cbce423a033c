"""Trainer `geometry`: teaches a matcher's network matches, depths, confidence and pose from data that knows them.

Nothing is rendered, so a step is cheap. All random numbers follow from (seed, step): a run that is stopped and resumed
gives the weights of one that was not.
"""

from pathlib import Path

import numpy as np
import torch
from pydantic import Field
from torch import Tensor

from edit3r import config, reporting
from edit3r.errors import SettingsError
from edit3r.interfaces import Trainer, TrainingJob
from edit3r.training.checkpoint import LAST, TrainingState, copied_weights
from edit3r.training.journal import Journal
from edit3r.training.schedule import batch_indices, step_generator, warmup_cosine
from edit3r.training.stopping import StopRequest
from edit3r_matching_network.network import CorrelationNetwork
from edit3r_matching_network.scene_memory import Augmentation, SceneMemory, augmented
from edit3r_matching_network.supervision import geometry_terms, match_error, rotation_errors, true_pairs
from edit3r_matching_network.weights import save_weights

VALIDATION_SCENES = 64


class GeometryTrainer(Trainer):
    """For a reconstructor whose matcher is `network`."""

    class Settings(config.Settings):
        steps: int = Field(6000, ge=1, description="optimiser steps")
        batch: int = Field(8, ge=1, le=256, description="pairs a step")
        lr: float = Field(1.5e-3, gt=0, le=1, description="highest learning rate")
        warmup: int = Field(200, ge=1, description="steps of linear warm-up")
        weight_decay: float = Field(0.01, ge=0, le=1, description="AdamW's")
        clip: float = Field(1.0, gt=0, description="largest gradient norm")
        average: float = Field(0.998, ge=0, lt=1, description="decay of the averaged weights, which are kept")
        seed: int = Field(0, ge=0, description="of data order and augmentation")
        exposure: float = Field(0.25, ge=0, le=1, description="most change of gain, bias and gamma between views")
        noise: float = Field(0.03, ge=0, le=0.5, description="most noise [sRGB]")
        narrow: float = Field(0.3, ge=0, le=1, description="how often the pictures lose rows")
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
        validate_every: int = Field(500, ge=1, description="steps between evaluations on held-out scenes")
        checkpoint_every: int = Field(200, ge=1, description="steps between checkpoints")
        log_every: int = Field(50, ge=1, description="steps between log lines")
        threads: int = Field(1, ge=0, description="CPU threads; 0 leaves torch's choice")

    def __init__(self, settings: Settings) -> None:
        self.settings = settings

    def train(self, job: TrainingJob) -> Path:
        """Train to the last step or until asked to stop; returns the folder of the best weights."""
        chosen = self.settings
        if chosen.threads:
            torch.set_num_threads(chosen.threads)
        state = self._state(job)
        journal, scenes = Journal(job.out, state.step), SceneMemory(job.train_data)
        held_out = None if job.validation_data is None else SceneMemory(job.validation_data)
        with StopRequest() as stop:
            while state.step < chosen.steps and not stop.asked:
                self._step(scenes, state, journal)
                last = state.step == chosen.steps
                if last or state.step % chosen.validate_every == 0:
                    self._validate(held_out, state, journal, job.out)
                if last or stop.asked or state.step % chosen.checkpoint_every == 0:
                    state.save(job.out / LAST)
                reporting.progress("training", state.step, chosen.steps)
        if stop.asked:
            reporting.warn(f"training stopped at step {state.step}; continue with --resume.")
        return job.out / "best"

    def _state(self, job: TrainingJob) -> TrainingState:
        torch.manual_seed(self.settings.seed)
        network = trainable_network(job)
        network.train()
        optimizer = torch.optim.AdamW(
            [p for p in network.parameters() if p.requires_grad],
            lr=self.settings.lr,
            betas=(0.9, 0.98),
            weight_decay=self.settings.weight_decay,
        )
        state = TrainingState(network, optimizer, copied_weights(network), config=dict(job.config or {}))
        if job.resume:
            state.load(job.out / LAST)
        else:
            _keep_best(job.out, state)  # so that there always is one
        return state

    def _step(self, scenes: SceneMemory, state: TrainingState, journal: Journal) -> None:
        """One optimiser step; one that is not finite is counted and left out."""
        chosen = self.settings
        for group in state.optimizer.param_groups:
            group["lr"] = chosen.lr * warmup_cosine(state.step, chosen.steps, chosen.warmup)
        terms = self._terms(scenes, state)
        loss = sum(getattr(chosen, name) * term for name, term in terms.items())
        state.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(state.network.parameters(), chosen.clip)
        state.step += 1
        if torch.isfinite(loss) and torch.isfinite(norm):
            state.optimizer.step()
            state.update_average(chosen.average)
        else:
            state.skipped += 1
            reporting.warn(f"step {state.step} was skipped: its loss or gradient is not finite.")
        if state.step % chosen.log_every == 0:
            values = {name: float(term.detach()) for name, term in terms.items()}
            journal.write(
                state.step, {"loss": float(loss.detach()), **values, "norm": float(norm), "skipped": state.skipped}
            )

    def _terms(self, scenes: SceneMemory, state: TrainingState) -> dict[str, Tensor]:
        chosen = self.settings
        indices = batch_indices(state.step, chosen.batch, len(scenes), chosen.seed)
        how = Augmentation(chosen.exposure, chosen.noise, chosen.narrow)
        batch = augmented(scenes.batch(indices), how, step_generator(chosen.seed, state.step, 0))
        terms = geometry_terms(state.network(batch.images, batch.intrinsics), batch)
        if state.step < chosen.pose_from:
            terms = {name: term for name, term in terms.items() if name not in ("rotation", "translation")}
        return terms

    @torch.no_grad()
    def _validate(self, scenes: SceneMemory | None, state: TrainingState, journal: Journal, out: Path) -> None:
        """Measure the averaged weights on held-out scenes, keep the best."""
        if scenes is None:
            _keep_best(out, state)
            return
        own = copied_weights(state.network)
        state.network.load_state_dict(state.average)
        state.network.eval()
        values = held_out_measures(state.network, scenes, self.settings.batch)
        state.network.load_state_dict(own)
        state.network.train()
        journal.write(state.step, values, kind="validation")
        if values["score"] < state.best:
            state.best = values["score"]
            _keep_best(out, state)


def held_out_measures(network: CorrelationNetwork, scenes: SceneMemory, size: int) -> dict[str, float]:
    """Over the first scenes: errors of match [cells], depth [log] and rotation [degrees]; `score` sums them up."""
    count = min(len(scenes), VALIDATION_SCENES)
    rows, turns = [], []
    for start in range(0, count, size):
        batch = scenes.batch(range(start, min(start + size, count)))
        prediction = network(batch.images, batch.intrinsics)
        truth = true_pairs(batch)
        error = match_error(prediction.places, truth)[truth.visible]
        terms = geometry_terms(prediction, batch)
        rows.append(
            {
                "match_median": float(error.median()),
                "within_cell": float((error < 1).float().mean()),
                **{name: float(terms[name]) for name in ("depth", "confidence", "coarse", "match")},
            }
        )
        turns.append(rotation_errors(prediction, batch))
    values = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    turns = torch.cat(turns)
    values |= {"rotation_median": float(turns.median()), "rotation_mean": float(turns.mean())}
    return values | {"score": values["match"] + 4 * values["depth"] + 0.1 * values["rotation_median"]}


def trainable_network(job: TrainingJob) -> CorrelationNetwork:
    """The network of the reconstructor's matcher."""
    matcher = getattr(job.reconstructor, "parts", {}).get("matcher")
    network = getattr(matcher, "network", None)
    if not isinstance(network, CorrelationNetwork):
        raise SettingsError(
            "training.reconstructor: trainer 'geometry' teaches the matcher 'network'; "
            "set reconstructor: {name: classical, matcher: {name: network, weights: untrained}}."
        )
    return network


def _keep_best(out: Path, state: TrainingState) -> None:
    save_weights(out / "best" / "weights.safetensors", state.average, state.network.sizes)
