"""From the network's prediction for pairs of views to poses and depth maps: Procrustes, adjustment, completion."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.rotations import cross_matrix
from edit3r_matching_network.adjustment import Adjusted, Estimate, Evidence, adjust, best_of, evidence_of, start_at
from edit3r_matching_network.network import PairPrediction
from edit3r_matching_network.point_pairs import cycle_error, pose_by_procrustes

TURNS = (-20.0, -7.0, 7.0, 20.0)
"""Further starts of the adjustment: view 1 gone around the scene by so much [degrees]."""
REACH = 60.0  # smoothness weight of completion
COLOUR = 12.0  # 8-bit colour difference at which the smoothness falls to 1/e
FARTHEST = 1.5
"""A depth moves at most so far from its prediction [log]."""
DOUBT = 20.0
"""Information [1 / log^2] at which a cell's own depth and its neighbours' corrections count the same."""


@dataclass(frozen=True)
class PairGeometry:
    """B pairs; lengths in the unit of view 0's depth prediction."""

    c2w: Float[Tensor, "batch 4 4"]  # of view 1 in view 0's frame
    depths: Float[Tensor, "batch 2 height width"]
    confidence: Float[Tensor, "batch 2 height width"]  # in [0, 1]


def pair_geometry(
    prediction: PairPrediction,
    intrinsics: Float[Tensor, "batch 2 3 3"],
    images: Float[Tensor, "batch 2 3 height2 width2"],
    adjusting: bool = True,
) -> PairGeometry:
    """Not differentiable. Without `adjusting` the pose is that of Procrustes and the depths are the predicted ones."""
    confidence = torch.sigmoid(prediction.confidence_logits) * torch.exp(-cycle_error(prediction.places).square())
    adjusted = _adjusted(prediction, confidence, intrinsics) if adjusting else _as_predicted(prediction, intrinsics)
    found, shape = adjusted.estimate, confidence.shape
    log_depths = found.log_depths.reshape(shape)
    if adjusting:
        scale = torch.stack((torch.zeros_like(found.log_scale), found.log_scale), 1)[..., None, None]
        log_depths = _completed(prediction.log_depths + scale, log_depths, adjusted.information.reshape(shape), images)
    return PairGeometry(
        _matrix(found.rotation, found.translation).to(confidence.dtype),
        log_depths.exp().to(confidence.dtype),
        confidence * _agreement(adjusted).reshape(shape).to(confidence.dtype),
    )


def _as_predicted(prediction: PairPrediction, intrinsics: Tensor) -> Adjusted:
    """Pose by Procrustes, every match taken to agree with it."""
    pose = pose_by_procrustes(prediction, intrinsics)
    log_depths = prediction.log_depths.flatten(2).clone()
    log_depths[:, 1] += pose.scale.log()[:, None]
    found = Estimate(pose.rotation, pose.translation, pose.scale.log(), log_depths)
    nothing = torch.zeros_like(log_depths)
    return Adjusted(found, nothing.sum((1, 2)), nothing, nothing)


def _adjusted(prediction: PairPrediction, confidence: Tensor, intrinsics: Tensor) -> Adjusted:
    """The best of several starts: Procrustes, and turns about the middle of what view 0 sees."""
    weighted = replace(prediction, confidence_logits=torch.logit(confidence, eps=1e-6))
    pose = pose_by_procrustes(weighted, intrinsics)
    depth = prediction.log_depths[:, 0].flatten(1).median(1).values.exp()
    starts = [(pose.rotation, pose.translation, pose.scale), *(_orbit(turn, depth) for turn in TURNS)]
    rotations, shifts, scales = (torch.stack(parts, 1).flatten(0, 1) for parts in zip(*starts))
    evidence = evidence_of(
        prediction.places, confidence, prediction.log_depths, prediction.log_spread.exp(), intrinsics
    )
    count = len(starts)
    several = Evidence(*(value.repeat_interleave(count, 0) for value in vars(evidence).values()))
    return best_of(adjust(several, start_at(several, rotations, shifts, scales)), count)


def _orbit(degrees: float, depth: Float[Tensor, "batch"]) -> tuple[Tensor, Tensor, Tensor]:
    """Rotation, translation and depth scale of a view 1 that has gone around a point straight ahead of view 0."""
    axis = depth.new_tensor([0.0, math.radians(degrees), 0.0])
    rotation = torch.linalg.matrix_exp(cross_matrix(axis)).expand(len(depth), 3, 3)
    ahead = depth[:, None] * depth.new_tensor([0.0, 0.0, 1.0])
    return rotation, ahead - (rotation @ ahead[..., None])[..., 0], torch.ones_like(depth)


def _agreement(adjusted: Adjusted) -> Tensor:
    """1 for a match that fits the pose, a half at 1 cell off."""
    return 1 / (1 + adjusted.residuals.square())


def _completed(prior: Tensor, found: Tensor, information: Tensor, images: Tensor) -> Tensor:
    """Spread the corrections of predicted log depth along the picture from where matches told them."""
    grid = prior.shape[-2:]
    small = torch.nn.functional.interpolate(images.flatten(0, 1), grid, mode="area")
    guides = (small.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    found = torch.minimum(torch.maximum(found, prior - FARTHEST), prior + FARTHEST)
    corrections = (found - prior).flatten(0, 1).cpu().numpy().astype(np.float32)
    share = information / (information + DOUBT)
    weights = share.flatten(0, 1).cpu().numpy().astype(np.float32)
    smooth = [_smooth(*maps) for maps in zip(corrections, weights, np.ascontiguousarray(guides))]
    smooth = torch.from_numpy(np.stack(smooth)).to(prior).reshape(prior.shape)
    return prior + smooth + share * (found - prior - smooth)


def _smooth(values: np.ndarray, weights: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Weighted mean along the picture, never beyond what went in; 0 far from any weight."""
    smoother = cv2.ximgproc.createFastGlobalSmootherFilter(guide, REACH, COLOUR)
    total = smoother.filter(weights + np.float32(1e-3))
    # The two filtered maps lose precision where hardly any weight reaches, and their ratio with it.
    return np.clip(smoother.filter(values * weights) / np.maximum(total, 1e-6), values.min(), values.max())


def _matrix(rotation: Tensor, translation: Tensor) -> Tensor:
    c2w = torch.eye(4, dtype=rotation.dtype, device=rotation.device).repeat(len(rotation), 1, 1)
    c2w[:, :3, :3], c2w[:, :3, 3] = rotation, translation
    return c2w
