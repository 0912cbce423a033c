"""Losses and measures of pixel-aligned Gaussians without rendering: cheap and dense, but blind to
what hides what.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.errors import SettingsError
from edit3r.contract.types import Cameras, Gaussians, Reconstruction
from edit3r.kit.compute.changes import change_error, change_uptake, mean_change
from edit3r.kit.geometry.cameras import invert_rigid, transform_points
from edit3r.kit.geometry.harmonics import dc_to_colour
from edit3r_training.batches import TrainingBatch

CHANGED = 0.02
"""A pixel whose true change is below this [sRGB, mean over channels] counts as outside the edit.
No figure kept.
"""


Depths = Float[Tensor, "batch view height width"]


@dataclass(frozen=True)
class PixelMaps:
    """The Gaussians of every view as images: each at the pixel it came from."""

    colours: Float[Tensor, "batch view 3 height width"]
    depths: Depths  # camera z in its own (predicted) view
    opacities: Float[Tensor, "batch view height width"]


def pixel_maps(reconstruction: Reconstruction, cameras: Cameras) -> PixelMaps:
    """Undo the view-major, row-major order of pixel-aligned Gaussians; any beyond (a rim) are left
    out. Several of one pixel are blended by their opacities.

    Depths are those in the predicted cameras, or in the true `cameras` of the views where none were
    predicted.
    """
    gaussians, (height, width) = reconstruction.gaussians, cameras.image_size
    each = reconstruction.per_pixel
    shape = (len(gaussians.means), cameras.count, height, width)
    wanted = cameras.count * height * width * each
    if each == 0 or gaussians.count < wanted:
        raise SettingsError(
            f"training.reconstructor: gives {gaussians.count} Gaussians for "
            f"{cameras.count * height * width} pixels; per-pixel errors need one for each pixel. "
            "Otherwise set the trainer's colour, depth and opacity to 0 and score to renderings."
        )
    if gaussians.count > wanted:
        gaussians = gaussians.select(torch.arange(wanted))
    if each > 1:
        gaussians = _blended(gaussians, each)
    colours = dc_to_colour(gaussians.harmonics[:, :, 0]).reshape(*shape, 3)
    seen_from = reconstruction.cameras or cameras
    means = gaussians.means.reshape(*shape, 3)
    points = transform_points(invert_rigid(seen_from.c2w), means)
    return PixelMaps(
        colours=colours.permute(0, 1, 4, 2, 3),
        depths=points[..., 2],
        opacities=gaussians.opacities.reshape(shape),
    )


def _blended(gaussians: Gaussians, each: int) -> Gaussians:
    """One Gaussian in place of `each` of a pixel: their means, weighted by opacity."""
    opacities = gaussians.opacities.unflatten(1, (-1, each))
    weights = opacities / opacities.sum(2, keepdim=True).clamp(min=1e-6)
    first = gaussians.select(torch.arange(0, gaussians.count, each))

    def mean(values: Tensor) -> Tensor:
        return torch.einsum(
            "bpk,bpk...->bp...", weights, values.unflatten(1, (-1, each))
        )

    return replace(
        first,
        means=mean(gaussians.means),
        harmonics=mean(gaussians.harmonics),
        opacities=1 - (1 - opacities).prod(2),
    )


def colour_error(maps: PixelMaps, batch: TrainingBatch) -> Float[Tensor, ""]:
    """Robust colour error of the other views: over the whole image plus over the edited part alone.

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
    gap = _log_gap(maps.depths, batch) * _as_before(batch)
    value = F.smooth_l1_loss(gap.clamp(-1, 1), torch.zeros_like(gap), beta=0.03)
    slopes = [gap.diff(dim=axis).clamp(-0.3, 0.3).abs().mean() for axis in (-1, -2)]
    return value + 0.25 * sum(slopes)


def opacity_error(
    maps: PixelMaps, batch: TrainingBatch, tolerance: float = 0.08
) -> Float[Tensor, ""]:
    """Cross-entropy to opacity 0.95 where log depth is right within `tolerance`, else 0.3."""
    gap = _log_gap(maps.depths.detach(), batch).abs()
    wished = torch.where(gap < tolerance, 0.95, 0.3)
    return F.binary_cross_entropy(
        maps.opacities.clamp(1e-4, 1 - 1e-4), wished, weight=_as_before(batch)
    )


def _as_before(batch: TrainingBatch) -> Depths:
    """1 where the true depths hold after the edit too, 0 where it may have moved the surface."""
    if batch.reshaped is None:
        return torch.ones_like(_true_depths(batch))
    return 1 - batch.reshaped.to(_true_depths(batch))


def _log_gap(depths: Depths, batch: TrainingBatch) -> Depths:
    """Log of predicted over true depth."""
    return torch.log(depths.clamp(min=1e-4)) - torch.log(_true_depths(batch))


def _true_depths(batch: TrainingBatch) -> Depths:
    assert batch.depths is not None  # whoever compares depths has asked
    return batch.depths


def edit_measures(maps: PixelMaps, batch: TrainingBatch) -> dict[str, float]:
    """How the own Gaussians of all views but the reference take up its edit, over the scenes of a
    batch that have one.

    uptake and error of the change inside the edit, leak [sRGB] outside, and the mean absolute error
    of log depth.
    """
    truth, source = batch.truth[:, 1:], batch.source.images[:, 1:]
    inside = _changed(truth, batch)[:, :, None].to(truth.dtype)
    shown, wished = maps.colours[:, 1:] - source, truth - source
    known = batch.depths is not None
    return {
        "uptake": change_uptake(shown, wished, inside),
        "error": change_error(shown, wished, inside),
        "leak": mean_change(shown, (1 - inside).expand_as(shown)),
        "depth": float(_log_gap(maps.depths, batch).abs().mean()) if known else 0.0,
    }


def _changed(
    truth: Float[Tensor, "batch other 3 height width"], batch: TrainingBatch
) -> Bool[Tensor, "batch other height width"]:
    """Which pixels of all views but the reference the true edit changes."""
    return (truth - batch.source.images[:, 1:]).abs().mean(2) > CHANGED
