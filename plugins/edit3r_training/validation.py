"""What a network does with held-out scenes, measured, and shown on a sheet of images."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import torch

from edit3r.contract import reporting
from edit3r.contract.errors import MatchingError, SettingsError
from edit3r.contract.interfaces import Dataset, TrainingJob
from edit3r.contract.types import Reconstruction
from edit3r.kit import asking
from edit3r.kit.photos.images import save_image
from edit3r.kit.reconstructing import WithMatcher
from edit3r_training.asymmetric_inputs import RegimeShares
from edit3r_training.batches import Match, TrainingBatch, Unit, make_batch
from edit3r_training.gaussian_errors import (
    PixelMaps,
    colour_error,
    depth_error,
    edit_measures,
    pixel_maps,
)
from edit3r_training.processes import Processes
from edit3r_training.schedule import step_generator
from edit3r_training.simulated_matching import simulate_match

MOST_SCENES = 64
SEED = 987_654_321


def reconstruct(job: TrainingJob, batch: TrainingBatch) -> Reconstruction:
    """With the batch's simulated matching where geometry is used, else the job's matcher's."""
    reconstructor, source = job.reconstructor, batch.source
    geometry = batch.geometry if reconstructor.uses_geometry else None
    if geometry is None:
        geometry = WithMatcher(reconstructor, job.matcher).geometry(source)
    return reconstructor(batch.edited, source, geometry)


@torch.no_grad()
def held_out_measures(
    job: TrainingJob,
    processes: Processes,
    batches: Sequence[TrainingBatch],
    rendered: bool,
    sheet: Path | None,
) -> dict[str, float]:
    """Measure the network on held-out scenes, each process on its share of them; empty when none
    could be matched.

    `rendered` makes the error of rendered novel views the score, instead of errors pixel by pixel.
    `sheet` is where to write images of the first scenes; None on processes that do not write.
    """
    network = job.reconstructor.network
    assert network is not None  # the recipe has asked
    device = next(network.parameters()).device
    rows, shown = [], None
    for held_out in batches[processes.rank :: processes.count]:
        batch = held_out.to(device)
        try:
            reconstruction = reconstruct(job, batch)
        except MatchingError:
            continue
        novel = _novel(job, reconstruction, batch) if rendered else {}
        if rendered and reconstruction.per_pixel == 0:
            rows.append(novel)
            continue
        maps = pixel_maps(reconstruction, batch.context_cameras)
        rows.append(_measured(maps, batch) | novel)
        shown = shown or (maps, batch)
    values = processes.means(rows)
    if not values:
        reporting.warn(
            "none of the held-out scenes could be matched; the best weights are the first ones."
        )
    if sheet is not None and shown is not None:
        _save_sheet(sheet, *shown)
    return values


def _novel(
    job: TrainingJob, reconstruction: Reconstruction, batch: TrainingBatch
) -> dict[str, float]:
    """Mean squared error of the rendered target views, which is the score too."""
    if batch.target_cameras.count == 0:
        raise SettingsError(
            "trainer.score: renderings need held-out scenes with novel views; give them targets."
        )
    drawn = asking.render(
        job.rasterizer, reconstruction.gaussians, batch.target_cameras
    )
    rendered = drawn.images
    error = float((rendered - batch.target).square().mean())
    return {"novel": error, "score": error}


def held_out_batches(
    data: Dataset,
    shares: RegimeShares,
    batch_size: int,
    unit: Unit,
    match: Match = simulate_match,
) -> list[TrainingBatch]:
    """Return the first scenes, with the same edits and errors every time."""
    size = min(batch_size, len(data))
    batches = []
    for start in range(0, min(len(data), MOST_SCENES) // size * size, size):
        generators = [step_generator(SEED, 0, start + slot) for slot in range(size)]
        indices = range(start, start + size)
        samples = [asking.sample(data, partial(data.__getitem__, i)) for i in indices]
        batches.append(make_batch(samples, shares, generators, unit, match))
    return batches


def _measured(maps: PixelMaps, batch: TrainingBatch) -> dict[str, float]:
    """All measures of one batch; `score` decides about the best weights."""
    colour = float(colour_error(maps, batch))
    depth = 0.0 if batch.depths is None else float(depth_error(maps, batch))
    return {"colour": colour, **edit_measures(maps, batch), "score": colour + depth}


def _save_sheet(
    path: Path, maps: PixelMaps, batch: TrainingBatch, rows: int = 6
) -> None:
    """Write a row a scene: reference and its edit; the last view, its own edit, the truth and the
    predicted colours.

    Where the data has depths, the last view's inverse depth follows: true, matched and predicted.
    """
    source, edited, truth = batch.source.images, batch.edited.images, batch.truth
    columns = [source[:, 0], edited[:, 0], source[:, -1], edited[:, -1], truth[:, -1]]
    columns.append(maps.colours[:, -1])
    if batch.geometry is not None and batch.depths is not None:
        near = batch.depths[:, -1].amin((1, 2), keepdim=True)
        for depths in (batch.depths, batch.geometry.depths, maps.depths):
            # Inverse depth, white where the true depth is smallest.
            grey = (near / depths[:, -1].clamp(min=1e-6)).clamp(0, 1)
            columns.append(grey[:, None].expand_as(truth[:, -1]))
    lines = torch.cat(columns, -1)[:rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    save_image(torch.cat(list(lines), -2).nan_to_num(), path)
