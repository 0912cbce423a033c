"""What is right on data with known depths and poses, and how far a prediction is from it."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.rotations import rotation_angle
from edit3r.geometry.warping import find_correspondences
from edit3r_matching_network.network import PairPrediction
from edit3r_matching_network.point_pairs import pose_by_procrustes
from edit3r_matching_network.scene_memory import GeometryBatch
from edit3r_matching_network.soft_matching import REACH

HIDDEN = 0.06
"""A point this much (in log depth) behind what the other view sees there is hidden from it."""
FAR_OFF = 6.0
"""Errors of a match beyond this count no more [cells]."""


@dataclass(frozen=True)
class PairTruth:
    """True matches and depths of both views on one grid."""

    places: Float[Tensor, "batch 2 height width 2"]  # in the other view, normalised
    visible: Bool[Tensor, "batch 2 height width"]  # in the other view, too
    log_depths: Float[Tensor, "batch 2 height width"]


def true_pairs(batch: GeometryBatch) -> PairTruth:
    """At half the pictures' size; a cell has the second nearest of its four pixels' depths, so a depth that exists."""
    depths = F.pixel_unshuffle(batch.depths, 2).unflatten(1, (2, 4)).sort(2).values[:, :, 1]
    matches = find_correspondences(depths, batch.intrinsics, batch.c2w)
    visible = (matches.inside > 0) & (matches.depth_ratio.abs() < HIDDEN)
    return PairTruth(matches.coordinates, visible, depths.log())


def coarser(truth: PairTruth) -> PairTruth:
    """On the tokens' grid: the mean of four cells of which at least three are seen and lie together."""
    places = _quarters(truth.places.movedim(-1, 2)).movedim(2, 3)  # [batch, 2, 4, 2, height, width]
    seen = _quarters(truth.visible[:, :, None].to(places.dtype)).movedim(2, 3)
    mean = (places * seen).sum(2) / seen.sum(2).clamp(min=1)
    size = places.new_tensor(truth.visible.shape[:1:-1])
    spread = ((places - mean[:, :, None]) * seen).abs().amax(2).movedim(2, -1) * size
    visible = (seen.sum(2)[:, :, 0] >= 3) & (spread < 3).all(-1)
    return PairTruth(mean.movedim(2, -1), visible, truth.log_depths[:, :, ::2, ::2])


def geometry_terms(prediction: PairPrediction, batch: GeometryBatch) -> dict[str, Tensor]:
    """Unweighted terms of the objective by name."""
    truth = true_pairs(batch)
    tokens = coarser(truth)
    error = match_error(prediction.places, truth)
    gap = prediction.log_depths - truth.log_depths
    unit = gap.detach().flatten(1).median(1).values  # the scene's own unit of length cannot be known
    apart = (gap - unit[:, None, None, None]).abs()
    spread = prediction.log_spread
    return {
        "coarse": _coarse_surprise(prediction, tokens),
        "corrected": _seen_mean(match_error(prediction.corrected, tokens).clamp(max=FAR_OFF), tokens.visible),
        "window": _window_surprise(prediction, truth),
        "match": _seen_mean(error.clamp(max=FAR_OFF), truth.visible),
        "confidence": F.binary_cross_entropy_with_logits(
            prediction.confidence_logits, (truth.visible & (error.detach() < 1)).to(error.dtype)
        ),
        "depth": apart.mean() + 0.25 * _slope_error(gap),
        "spread": (apart.detach() * (-spread).exp() + spread).mean(),
        "unit": unit_error(prediction, truth),
        **_pose_terms(prediction, batch, unit),
    }


def unit_error(prediction: PairPrediction, truth: PairTruth) -> Float[Tensor, ""]:
    """Of the absolute depth, as far as the data has a usual one."""
    return (prediction.log_depths - truth.log_depths).flatten(1).mean(1).abs().mean()


def match_error(places: Tensor, truth: PairTruth) -> Float[Tensor, "batch 2 height width"]:
    """Distance of matches from the true ones [cells of the truth's grid]."""
    size = places.new_tensor(truth.visible.shape[:1:-1])
    return (((places - truth.places) * size).square().sum(-1) + 1e-6).sqrt()


def _pose_terms(prediction: PairPrediction, batch: GeometryBatch, unit: Tensor) -> dict[str, Tensor]:
    """Chord between the rotations, and the baseline's error relative to its length (at most 2)."""
    pose = pose_by_procrustes(prediction, batch.intrinsics, every=2)
    true_turn, true_shift = batch.c2w[:, 1, :3, :3], batch.c2w[:, 1, :3, 3]
    turn = (pose.rotation - true_turn).flatten(1).norm(dim=1)
    shift = (pose.translation * (-unit).exp()[:, None] - true_shift).norm(dim=1) / true_shift.norm(dim=1).clamp(min=0.1)
    return {"rotation": turn.clamp(max=1).mean(), "translation": shift.clamp(max=2).mean()}


def rotation_errors(prediction: PairPrediction, batch: GeometryBatch) -> Float[Tensor, "batch"]:
    """Of view 1's pose by Procrustes [degrees]."""
    pose = pose_by_procrustes(prediction, batch.intrinsics)
    return torch.rad2deg(rotation_angle(pose.rotation, batch.c2w[:, 1, :3, :3]))


def _coarse_surprise(prediction: PairPrediction, truth: PairTruth) -> Tensor:
    size = truth.places.new_tensor(truth.visible.shape[:1:-1])
    spots = (truth.places * size - 0.5).flatten(2, 3)
    surprise = _surprise(prediction.coarse.log_probabilities, spots, tuple(truth.visible.shape[-2:]))
    return _seen_mean(surprise, truth.visible.flatten(2))


def _window_surprise(prediction: PairPrediction, truth: PairTruth) -> Tensor:
    """Over the cells whose true match lies in their window."""
    window = prediction.window
    size = truth.places.new_tensor(truth.visible.shape[:1:-1])
    spots = (truth.places * size - 0.5).flatten(2, 3) - window.corners
    inside = ((spots >= 0) & (spots <= REACH - 1)).all(-1)
    surprise = _surprise(window.logits.log_softmax(-1), spots, (REACH, REACH))
    return _seen_mean(surprise.clamp(max=20), truth.visible.flatten(2) & inside)


def _surprise(log_p: Tensor, spots: Float[Tensor, "batch 2 cell 2"], grid: tuple[int, int]) -> Tensor:
    """Cross-entropy to the true spot (column, row), shared bilinearly by its four neighbours."""
    height, width = grid
    size = spots.new_tensor((width, height))
    spots = torch.minimum(spots.clamp(min=0), size - 1)
    base = torch.minimum(spots.floor(), (size - 2).clamp(min=0))
    part = spots - base
    total = 0
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1])
            index = ((base[..., 1] + dy) * width + base[..., 0] + dx).long()
            total = total - weight * log_p.gather(-1, index[..., None])[..., 0]
    return total


def _slope_error(gap: Tensor) -> Tensor:
    """Of log depth's differences between neighbours."""
    return sum(gap.diff(dim=axis).clamp(-0.3, 0.3).abs().mean() for axis in (-1, -2))


def _seen_mean(values: Tensor, visible: Tensor) -> Tensor:
    return (values * visible).sum() / visible.sum().clamp(min=1)


def _quarters(maps: Float[Tensor, "batch 2 channel height width"]) -> Tensor:
    """`[batch, 2, channel, 4, height / 2, width / 2]`."""
    return F.pixel_unshuffle(maps.flatten(0, 1), 2).unflatten(1, (-1, 4)).unflatten(0, (-1, 2))
