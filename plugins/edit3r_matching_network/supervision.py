"""What is right on data with known depths and poses, and how far a prediction is from it."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.rotations import rotation_angle
from edit3r.geometry.warping import find_correspondences
from edit3r_matching_network.network import PairPrediction
from edit3r_matching_network.pair_geometry import pose_by_procrustes
from edit3r_matching_network.soft_matching import REACH
from edit3r_matching_network.training_pairs import TrainingPairs

HIDDEN = 0.06
"""A point this much (in log depth) behind what the other view sees there is hidden from it."""
FAR_OFF = 6.0
"""Errors of a match beyond this count no more [cells]."""


@dataclass(frozen=True)
class PairTruth:
    """True matches and depths of both views on one grid."""

    coordinates: Float[Tensor, "batch 2 height width 2"]  # in the other view, normalised
    visible: Bool[Tensor, "batch 2 height width"]  # in the other view, too
    log_depths: Float[Tensor, "batch 2 height width"]


def true_pairs(batch: TrainingPairs) -> PairTruth:
    """At half the images' size; a cell has the second nearest of its four pixels' depths, so a depth that exists."""
    depths = F.pixel_unshuffle(batch.depths, 2).unflatten(1, (2, 4)).sort(2).values[:, :, 1]
    matches = find_correspondences(depths, batch.intrinsics, batch.c2w)
    visible = (matches.inside > 0) & (matches.depth_ratio.abs() < HIDDEN)
    return PairTruth(matches.coordinates, visible, depths.log())


def coarser(truth: PairTruth) -> PairTruth:
    """On the tokens' grid: the mean of four cells of which at least three are seen and lie together."""
    coordinates = _quarters(truth.coordinates.movedim(-1, 2)).movedim(2, 3)  # [batch, 2, 4, 2, height, width]
    seen = _quarters(truth.visible[:, :, None].to(coordinates.dtype)).movedim(2, 3)
    mean = (coordinates * seen).sum(2) / seen.sum(2).clamp(min=1)
    size = coordinates.new_tensor(truth.visible.shape[:1:-1])
    spread = ((coordinates - mean[:, :, None]) * seen).abs().amax(2).movedim(2, -1) * size
    visible = (seen.sum(2)[:, :, 0] >= 3) & (spread < 3).all(-1)
    return PairTruth(mean.movedim(2, -1), visible, truth.log_depths[:, :, ::2, ::2])


def geometry_terms(prediction: PairPrediction, batch: TrainingPairs) -> dict[str, Float[Tensor, ""]]:
    """Unweighted terms of the objective by name."""
    truth = true_pairs(batch)
    tokens = coarser(truth)
    error = match_error(prediction.coordinates, truth)
    gap = prediction.log_depths - truth.log_depths
    unit = gap.detach().flatten(1).median(1).values  # the scene's own unit of length cannot be known
    apart = (gap - unit[:, None, None, None]).abs()
    spread = prediction.log_spread
    return {
        "coarse": _coarse_cross_entropy(prediction, tokens),
        "corrected": _seen_mean(match_error(prediction.corrected, tokens).clamp(max=FAR_OFF), tokens.visible),
        "window": _window_cross_entropy(prediction, truth),
        "match": _seen_mean(error.clamp(max=FAR_OFF), truth.visible),
        "confidence": F.binary_cross_entropy_with_logits(
            prediction.confidence_logits, (truth.visible & (error.detach() < 1)).to(error.dtype)
        ),
        "depth": apart.mean() + 0.25 * _slope_error(gap),
        "spread": (apart.detach() * (-spread).exp() + spread).mean(),
        "unit": gap.flatten(1).mean(1).abs().mean(),  # of the absolute depth, as far as the data has a usual one
        **_pose_terms(prediction, batch, unit),
    }


def match_error(
    coordinates: Float[Tensor, "batch 2 height width 2"], truth: PairTruth
) -> Float[Tensor, "batch 2 height width"]:
    """Distance of matches from the true ones [cells of the truth's grid]."""
    size = coordinates.new_tensor(truth.visible.shape[:1:-1])
    return (((coordinates - truth.coordinates) * size).square().sum(-1) + 1e-6).sqrt()


def _pose_terms(
    prediction: PairPrediction, batch: TrainingPairs, unit: Float[Tensor, "batch"]
) -> dict[str, Float[Tensor, ""]]:
    """Chord between the rotations, and the baseline's error relative to its length (at most 2)."""
    pose = pose_by_procrustes(prediction, batch.intrinsics, every=2)
    true_turn, true_shift = batch.c2w[:, 1, :3, :3], batch.c2w[:, 1, :3, 3]
    turn = (pose.rotation - true_turn).flatten(1).norm(dim=1)
    shift = (pose.translation * (-unit).exp()[:, None] - true_shift).norm(dim=1) / true_shift.norm(dim=1).clamp(min=0.1)
    return {"rotation": turn.clamp(max=1).mean(), "translation": shift.clamp(max=2).mean()}


def rotation_errors(prediction: PairPrediction, batch: TrainingPairs) -> Float[Tensor, "batch"]:
    """Error of the rotation of view 1's pose by Procrustes [degrees]."""
    pose = pose_by_procrustes(prediction, batch.intrinsics)
    return torch.rad2deg(rotation_angle(pose.rotation, batch.c2w[:, 1, :3, :3]))


def _coarse_cross_entropy(prediction: PairPrediction, truth: PairTruth) -> Float[Tensor, ""]:
    """Mean over the tokens that the other view shows."""
    size = truth.coordinates.new_tensor(truth.visible.shape[:1:-1])
    positions = (truth.coordinates * size - 0.5).flatten(2, 3)
    entropy = _cross_entropy(prediction.coarse.log_probabilities, positions, tuple(truth.visible.shape[-2:]))
    return _seen_mean(entropy, truth.visible.flatten(2))


def _window_cross_entropy(prediction: PairPrediction, truth: PairTruth) -> Float[Tensor, ""]:
    """Mean over the visible cells whose true match lies in their window."""
    window = prediction.window
    size = truth.coordinates.new_tensor(truth.visible.shape[:1:-1])
    positions = (truth.coordinates * size - 0.5).flatten(2, 3) - window.corners
    inside = ((positions >= 0) & (positions <= REACH - 1)).all(-1)
    entropy = _cross_entropy(window.logits.log_softmax(-1), positions, (REACH, REACH))
    return _seen_mean(entropy.clamp(max=20), truth.visible.flatten(2) & inside)


def _cross_entropy(
    log_p: Float[Tensor, "batch 2 cell window"], target: Float[Tensor, "batch 2 cell 2"], grid: tuple[int, int]
) -> Float[Tensor, "batch 2 cell"]:
    """Cross-entropy to the true position (column, row) in `grid`, shared bilinearly by its four neighbours."""
    height, width = grid
    size = target.new_tensor((width, height))
    target = torch.minimum(target.clamp(min=0), size - 1)
    base = torch.minimum(target.floor(), (size - 2).clamp(min=0))
    part = target - base
    total = 0
    for dx in (0, 1):
        for dy in (0, 1):
            weight = (part[..., 0] if dx else 1 - part[..., 0]) * (part[..., 1] if dy else 1 - part[..., 1])
            index = ((base[..., 1] + dy) * width + base[..., 0] + dx).long()
            total = total - weight * log_p.gather(-1, index[..., None])[..., 0]
    return total


def _slope_error(gap: Float[Tensor, "batch 2 height width"]) -> Float[Tensor, ""]:
    """Error of log depth's differences between neighbouring cells."""
    return sum(gap.diff(dim=axis).clamp(-0.3, 0.3).abs().mean() for axis in (-1, -2))


def _seen_mean(values: Float[Tensor, "*shape"], visible: Bool[Tensor, "*shape"]) -> Float[Tensor, ""]:
    """Mean over the visible cells; 0 without any."""
    return (values * visible).sum() / visible.sum().clamp(min=1)


def _quarters(maps: Float[Tensor, "batch 2 channel height width"]) -> Float[Tensor, "batch 2 channel 4 h2 w2"]:
    """The four cells of each token on an axis of their own."""
    return F.pixel_unshuffle(maps.flatten(0, 1), 2).unflatten(1, (-1, 4)).unflatten(0, (-1, 2))
