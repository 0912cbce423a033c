"""Held-out scenes while training: averaged weights measured, a sheet of pictures, the best weights kept."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
import safetensors.torch
import torch

from edit3r import reporting
from edit3r.errors import MatchingError, RunError
from edit3r.interfaces import Dataset, MatchedGeometry, TrainingJob
from edit3r.training.checkpoint import TrainingState, copied_weights
from edit3r.training.journal import Journal
from edit3r.training.processes import Processes
from edit3r.training.schedule import step_generator
from edit3r.types import Reconstruction, Views
from edit3r_training.batches import TrainingBatch, make_batch
from edit3r_training.edit_regimes import RegimeShares
from edit3r_training.sample_sheet import save_sample_sheet
from edit3r_training.supervision import PixelMaps, colour_error, depth_error, measure_edit, pixel_maps

MOST_SCENES = 64
SEED = 987_654_321


@runtime_checkable
class GeometryConditioned(Protocol):
    """A reconstructor that can be handed geometry instead of matching photos itself."""

    def from_geometry(self, views: Views, source: Views, geometry: MatchedGeometry) -> Reconstruction: ...


def reconstruct(job: TrainingJob, batch: TrainingBatch) -> Reconstruction:
    """With the batch's simulated matching where the reconstructor takes geometry, else from the pictures alone."""
    reconstructor = job.reconstructor
    if batch.geometry is not None and isinstance(reconstructor, GeometryConditioned):
        return reconstructor.from_geometry(batch.edited, batch.source, batch.geometry)
    return reconstructor(batch.edited, batch.source)


@torch.no_grad()
def validate(
    job: TrainingJob,
    state: TrainingState,
    journal: Journal | None,
    processes: Processes,
    shares: RegimeShares,
    batch_size: int,
) -> None:
    """Measure the averaged weights on held-out scenes, each process on its share of them; keep the best.

    `journal` is None on processes that do not write.
    """
    if job.validation_data is None:
        if processes.writes:
            keep_best(job.out, state)
        return
    batches = _batches(job.validation_data, shares, batch_size)[processes.rank :: processes.count]
    with averaged_weights(state):
        maps = _maps(job, [batch.to(_device_of(state)) for batch in batches])
    values = means(processes.gathered([_measured(m, b) for m, b in maps]))
    if not values:
        reporting.warn("none of the held-out scenes could be matched; the best weights are the first ones.")
        return
    improved = values["score"] < state.best
    state.best = min(state.best, values["score"])
    if journal is not None:
        journal.write(state.step, values, kind="validation")
        if maps:
            save_sample_sheet(job.out / "sheets" / f"{state.step:07d}.png", *maps[0])
        if improved:
            keep_best(job.out, state)


def means(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Mean of each value over the rows that have any, which have the same names."""
    full = [row for row in rows if row]
    return {name: float(np.mean([row[name] for row in full])) for name in (full[0] if full else ())}


def _maps(job: TrainingJob, batches: Sequence[TrainingBatch]) -> list[tuple[PixelMaps, TrainingBatch]]:
    """What the network makes of each batch; those that cannot be matched are left out."""
    found = []
    for batch in batches:
        with contextlib.suppress(MatchingError):
            reconstruction = reconstruct(job, batch)
            found.append((pixel_maps(reconstruction, batch.source.count, batch.source.image_size), batch))
    return found


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


def _device_of(state: TrainingState) -> torch.device:
    return next(iter(state.average.values())).device


def _batches(data: Dataset, shares: RegimeShares, batch_size: int) -> list[TrainingBatch]:
    """The first scenes, with the same edits and errors every time."""
    size = min(batch_size, len(data))
    batches = []
    for start in range(0, min(len(data), MOST_SCENES) // size * size, size):
        generators = [step_generator(SEED, 0, start + slot) for slot in range(size)]
        samples = [data[start + slot] for slot in range(size)]
        batches.append(make_batch(samples, shares, generators))
    return batches


def _measured(maps: PixelMaps, batch: TrainingBatch) -> dict[str, float]:
    measures = measure_edit(maps, batch)
    colour = float(colour_error(maps, batch))
    values = {"colour": colour, **vars(measures)}
    values["score"] = colour + (float(depth_error(maps, batch)) if batch.depths is not None else 0.0)
    return values


def keep_best(out: Path, state: TrainingState) -> None:
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
