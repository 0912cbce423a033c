"""What a network does with held-out scenes, measured, and shown on a sheet of images."""

import contextlib
from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import reporting
from edit3r.contract.interfaces import Dataset, TakesGeometry, TrainingJob
from edit3r.contract.types import Reconstruction
from edit3r.errors import MatchingError, SettingsError
from edit3r.io.images import save_image
from edit3r_training.asymmetric_inputs import RegimeShares
from edit3r_training.batches import Match, TrainingBatch, Unit, make_batch
from edit3r_training.pixel_losses import (
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
    """With the batch's simulated matching where the reconstructor takes geometry, else from the
    images alone.
    """
    reconstructor = job.reconstructor
    if batch.geometry is not None and isinstance(reconstructor, TakesGeometry):
        return reconstructor.from_geometry(batch.edited, batch.source, batch.geometry)
    return reconstructor(batch.edited, batch.source)


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
    device = next(job.reconstructor.network.parameters()).device
    made = _reconstructions(
        job, [batch.to(device) for batch in batches[processes.rank :: processes.count]]
    )
    maps = [
        (pixel_maps(reconstruction, batch.context_cameras), batch)
        for reconstruction, batch in made
    ]
    rows = [_measured(m, b) for m, b in maps]
    if rendered:
        rows = [row | _novel(job, *one) for row, one in zip(rows, made)]
    values = processes.means(rows)
    if not values:
        reporting.warn(
            "none of the held-out scenes could be matched; the best weights are the first ones."
        )
    if sheet is not None and maps:
        _save_sheet(sheet, *maps[0])
    return values


def _reconstructions(
    job: TrainingJob, batches: Sequence[TrainingBatch]
) -> list[tuple[Reconstruction, TrainingBatch]]:
    """What the network makes of each batch; those that cannot be matched are left out."""
    found = []
    for batch in batches:
        with contextlib.suppress(MatchingError):
            found.append((reconstruct(job, batch), batch))
    return found


def _novel(
    job: TrainingJob, reconstruction: Reconstruction, batch: TrainingBatch
) -> dict[str, float]:
    """Mean squared error of the rendered target views, which is the score too."""
    if batch.target_cameras.count == 0:
        raise SettingsError(
            "trainer.score: renderings need held-out scenes with novel views; give them targets."
        )
    rendered = job.rasterizer.render(
        reconstruction.gaussians, batch.target_cameras
    ).images
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
        samples = [data[start + slot] for slot in range(size)]
        batches.append(make_batch(samples, shares, generators, unit, match))
    return batches


def _measured(maps: PixelMaps, batch: TrainingBatch) -> dict[str, float]:
    """All measures of one batch; `score` decides about the best weights."""
    colour = float(colour_error(maps, batch))
    score = colour + (
        float(depth_error(maps, batch)) if batch.depths is not None else 0.0
    )
    return {"colour": colour, **edit_measures(maps, batch), "score": score}


def _save_sheet(
    path: Path, maps: PixelMaps, batch: TrainingBatch, rows: int = 6
) -> None:
    """Write a row a scene: reference and its edit; the last view, its own edit, the truth and the
    predicted colours.

    Where the data has depths, the last view's inverse depth follows: true, matched and predicted.
    """
    lines = []
    for scene in range(min(rows, len(batch.truth))):
        last = batch.truth.shape[1] - 1
        images = [
            batch.source.images[scene, 0],
            batch.edited.images[scene, 0],
            batch.source.images[scene, last],
            batch.edited.images[scene, last],
            batch.truth[scene, last],
            maps.colours[scene, last],
        ]
        if batch.depths is not None and batch.geometry is not None:
            shown = (batch.depths, batch.geometry.depths, maps.depths)
            images += [
                _inverse_depth(d[scene, last], batch.depths[scene, last]) for d in shown
            ]
        lines.append(torch.cat(images, -1))
    path.parent.mkdir(parents=True, exist_ok=True)
    save_image(torch.cat(lines, -2).nan_to_num(), path)


def _inverse_depth(
    depths: Float[Tensor, "height width"], truth: Float[Tensor, "height width"]
) -> Float[Tensor, "3 height width"]:
    """Inverse depth as grey, white where the true depth is smallest."""
    inverse = 1 / depths.clamp(min=1e-6)
    top = (1 / truth).max()
    return (inverse / top).clamp(0, 1).expand(3, -1, -1)
