"""Direct supervision of pixel-aligned Gaussians, without rendering: cheap, dense, and blind to what hides what."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.errors import SettingsError
from edit3r.geometry.cameras import invert_rigid, transform_points
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.types import Reconstruction
from edit3r_training.batches import TrainingBatch

CHANGED = 0.02
"""A pixel whose true change is below this [sRGB, mean over channels] counts as outside the edit."""


@dataclass(frozen=True)
class PixelMaps:
    """The Gaussians of every view as pictures: each at the pixel it came from."""

    colours: Float[Tensor, "batch view 3 height width"]
    depths: Float[Tensor, "batch view height width"]  # camera z in its own (predicted) view
    opacities: Float[Tensor, "batch view height width"]


def pixel_maps(reconstruction: Reconstruction, views: int, image_size: tuple[int, int]) -> PixelMaps:
    """Undo the view-major, row-major order of pixel-aligned Gaussians; any beyond one a pixel (a rim) are left out."""
    gaussians, pixels = reconstruction.gaussians, views * image_size[0] * image_size[1]
    if gaussians.count < pixels:
        raise SettingsError(
            f"training.reconstructor: gives {gaussians.count} Gaussians for {pixels} pixels; the recolor trainer needs "
            "one that gives every pixel its own."
        )
    if gaussians.count > pixels:
        gaussians = gaussians.select(torch.arange(pixels))
    shape = (gaussians.means.shape[0], views, *image_size)
    colours = dc_to_colour(gaussians.harmonics[:, :, 0]).reshape(*shape, 3).permute(0, 1, 4, 2, 3)
    points = gaussians.means.reshape(*shape, 3)
    camera = (
        points if reconstruction.cameras is None else transform_points(invert_rigid(reconstruction.cameras.c2w), points)
    )
    return PixelMaps(colours, camera[..., 2], gaussians.opacities.reshape(shape))


def colour_error(maps: PixelMaps, batch: TrainingBatch) -> Float[Tensor, ""]:
    """Robust colour error of the other views: over the whole picture plus over the edited part alone.

    The second term gives a small object the weight of a large one.
    """
    predicted, truth = maps.colours[:, 1:], batch.truth[:, 1:]
    error = F.smooth_l1_loss(predicted, truth, beta=0.05, reduction="none").mean(2)
    inside = _changed(truth, batch).to(error.dtype)
    count = inside.sum((2, 3))
    edited = ((error * inside).sum((2, 3)) / count.clamp(min=1))[count > 20]
    part = edited.mean() if len(edited) else error.sum() * 0
    return 2 * error.mean() + part


def depth_error(maps: PixelMaps, batch: TrainingBatch) -> Float[Tensor, ""]:
    """Robust error of log depth and of its differences between neighbours."""
    gap = torch.log(maps.depths.clamp(min=1e-4)) - torch.log(batch.depths)
    value = F.smooth_l1_loss(gap.clamp(-1, 1), torch.zeros_like(gap), beta=0.03)
    slopes = [gap.diff(dim=axis).clamp(-0.3, 0.3).abs().mean() for axis in (-1, -2)]
    return value + 0.25 * sum(slopes)


def opacity_error(maps: PixelMaps, batch: TrainingBatch, tolerance: float = 0.08) -> Float[Tensor, ""]:
    """Cross-entropy to 0.95 where the depth is right within `tolerance` (in log), to 0.3 where it is not."""
    gap = (torch.log(maps.depths.detach().clamp(min=1e-4)) - torch.log(batch.depths)).abs()
    wish = torch.where(gap < tolerance, 0.95, 0.3)
    return F.binary_cross_entropy(maps.opacities.clamp(1e-4, 1 - 1e-4), wish)


@dataclass(frozen=True)
class EditMeasures:
    """How the last view's own Gaussians take up the reference's edit, over the scenes of a batch that have one."""

    uptake: float  # projection of the change shown on the true change inside the edit; 1 is all of it
    error: float  # mean absolute error over mean absolute true change, inside
    leak: float  # mean absolute change outside the edit [sRGB]
    depth: float  # mean absolute log-depth error


def measure_edit(maps: PixelMaps, batch: TrainingBatch) -> EditMeasures:
    """Measured on the colours of all views but the reference."""
    predicted, truth, source = maps.colours[:, 1:], batch.truth[:, 1:], batch.source.images[:, 1:]
    inside = _changed(truth, batch)[:, :, None].to(truth.dtype)
    shown, true = predicted - source, truth - source
    total = (true.square() * inside).sum().clamp(min=1e-9)
    gap = torch.log(maps.depths / batch.depths).abs().mean() if batch.depths is not None else torch.tensor(0.0)
    return EditMeasures(
        uptake=float((shown * true * inside).sum() / total),
        error=float(((shown - true).abs() * inside).sum() / (true.abs() * inside).sum().clamp(min=1e-9)),
        leak=float((shown.abs() * (1 - inside)).sum() / (3 * (1 - inside).sum()).clamp(min=1)),
        depth=float(gap),
    )


def _changed(truth: Tensor, batch: TrainingBatch) -> Tensor:
    return (truth - batch.source.images[:, 1:]).abs().mean(2) > CHANGED
