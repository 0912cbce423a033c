"""From the network's prediction for pairs of views to poses and depth maps: Procrustes, adjustment, completion."""

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r_correlation.adjustment import Adjusted, adjust, evidence_of, start_at
from edit3r_correlation.network import PairPrediction
from edit3r_correlation.point_pairs import pose_by_procrustes

REACH = 60.0  # smoothness weight of completion
COLOUR = 12.0  # 8-bit colour difference at which the smoothness falls to 1/e
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
    pose = pose_by_procrustes(prediction, intrinsics)
    confidence = torch.sigmoid(prediction.confidence_logits)
    evidence = evidence_of(
        prediction.places, confidence, prediction.log_depths, prediction.log_spread.exp(), intrinsics
    )
    start = start_at(evidence, pose.rotation, pose.translation, pose.scale)
    adjusted = adjust(evidence, start, rounds=15 if adjusting else 0)
    found = adjusted.estimate
    shape = confidence.shape
    prior = evidence.prior + torch.stack((torch.zeros_like(found.log_scale), found.log_scale), 1)[..., None]
    log_depths = found.log_depths.reshape(shape)
    if adjusting:
        log_depths = _completed(prior.reshape(shape), log_depths, adjusted.information.reshape(shape), images)
    return PairGeometry(
        _matrix(found.rotation, found.translation).to(confidence.dtype),
        log_depths.exp().to(confidence.dtype),
        confidence * _agreement(adjusted).reshape(shape).to(confidence.dtype),
    )


def _agreement(adjusted: Adjusted) -> Tensor:
    """1 for a match that fits the pose, a half at 1 cell off."""
    return 1 / (1 + adjusted.residuals.square())


def _completed(prior: Tensor, found: Tensor, information: Tensor, images: Tensor) -> Tensor:
    """Spread the corrections of predicted log depth along the picture from where matches told them."""
    grid = prior.shape[-2:]
    small = torch.nn.functional.interpolate(images.flatten(0, 1), grid, mode="area")
    guides = (small.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    corrections = (found - prior).flatten(0, 1).cpu().numpy().astype(np.float32)
    weights = information.flatten(0, 1).cpu().numpy().astype(np.float32)
    smooth = [_smooth(*maps) for maps in zip(corrections, weights, np.ascontiguousarray(guides))]
    smooth = torch.from_numpy(np.stack(smooth)).to(prior).reshape(prior.shape)
    share = information / (information + DOUBT)
    return prior + smooth + share * (found - prior - smooth)


def _smooth(values: np.ndarray, weights: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Weighted mean along the picture; 0 far from any weight."""
    smoother = cv2.ximgproc.createFastGlobalSmootherFilter(guide, REACH, COLOUR)
    total = smoother.filter(weights + np.float32(1e-3))
    return smoother.filter(values * weights) / np.maximum(total, 1e-8)


def _matrix(rotation: Tensor, translation: Tensor) -> Tensor:
    c2w = torch.eye(4, dtype=rotation.dtype, device=rotation.device).repeat(len(rotation), 1, 1)
    c2w[:, :3, :3], c2w[:, :3, 3] = rotation, translation
    return c2w
