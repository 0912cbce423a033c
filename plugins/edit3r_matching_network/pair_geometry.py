"""From the network's prediction for pairs of views to poses and depth maps: Procrustes, adjustment, completion."""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from edit3r.geometry.alignment import Similarity, robust_similarity
from edit3r.geometry.cameras import pixel_grid, pixel_rays
from edit3r.geometry.rotations import cross_matrix
from edit3r.geometry.warping import warp
from edit3r_matching_network.network import PairPrediction
from edit3r_matching_network.two_view_adjustment import (
    Adjusted,
    Estimate,
    Evidence,
    adjust,
    best_of,
    evidence_of,
    rays_through,
    start_at,
)

TURNS = (-20.0, -7.0, 7.0, 20.0)
"""Further starts of the adjustment: how far view 1 has gone around the scene [degrees]."""
REACH = 60.0
"""Smoothness weight of completion."""
COLOUR = 12.0
"""8-bit colour difference at which the smoothness falls to 1/e."""
FARTHEST = 1.5
"""How far a depth may move from its prediction [log]."""
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
    """Pose, depths and confidence that agree best with the prediction; not differentiable.

    Without `adjusting` the pose is that of Procrustes and the depths are the predicted ones.
    """
    confidence = torch.sigmoid(prediction.confidence_logits) * torch.exp(-cycle_error(prediction.coordinates).square())
    adjusted = _adjusted(prediction, confidence, intrinsics) if adjusting else _as_predicted(prediction, intrinsics)
    found, shape = adjusted.estimate, confidence.shape
    log_depths = found.log_depths.reshape(shape)
    if adjusting:
        scale = torch.stack((torch.zeros_like(found.log_scale), found.log_scale), 1)[..., None, None]
        log_depths = _completed(prediction.log_depths + scale, log_depths, adjusted.information.reshape(shape), images)
    agreement = 1 / (1 + adjusted.residuals.square())  # a half where a match is 1 cell off
    return PairGeometry(
        _matrix(found.rotation, found.translation).to(confidence.dtype),
        log_depths.exp().to(confidence.dtype),
        confidence * agreement.reshape(shape).to(confidence.dtype),
    )


def pose_by_procrustes(
    prediction: PairPrediction, intrinsics: Float[Tensor, "batch 2 3 3"], every: int = 1
) -> Similarity:
    """What takes points of view 1's camera into view 0's; its scale is what view 1's depths are to be multiplied by.

    The points are every `every`-th cell (along both axes) of view 1, and their matches in view 0.
    """
    part = slice(every // 2, None, every)
    log_depths = prediction.log_depths[:, 1, part, part]
    coordinates = prediction.coordinates[:, 1, part, part]
    rays = pixel_rays(intrinsics[:, 1], prediction.log_depths.shape[-2:])[:, part, part]
    second = rays * log_depths.exp()[..., None]
    log_there = warp(prediction.log_depths[:, 0, None], coordinates)[:, 0]
    first = rays_through(coordinates, intrinsics[:, 0]) * log_there.exp()[..., None]
    weights = torch.sigmoid(prediction.confidence_logits[:, 1, part, part]) * (-log_depths.detach()).exp()
    return robust_similarity(second.flatten(1, 2), first.flatten(1, 2), weights.flatten(1))


def cycle_error(
    coordinates: Float[Tensor, "batch 2 height width 2"],
) -> Float[Tensor, "batch 2 height width"]:
    """How far from its start a cell ends that goes to the other view and back along the matches [cells]."""
    grid = coordinates.shape[2:4]
    back = warp(coordinates.flip(1).movedim(-1, 2), coordinates).movedim(2, -1)
    return ((back - pixel_grid(grid, coordinates)) * coordinates.new_tensor(grid[::-1])).norm(dim=-1)


def _as_predicted(prediction: PairPrediction, intrinsics: Float[Tensor, "batch 2 3 3"]) -> Adjusted:
    """Pose by Procrustes, every match taken to agree with it."""
    pose = pose_by_procrustes(prediction, intrinsics)
    log_depths = prediction.log_depths.flatten(2).clone()
    log_depths[:, 1] += pose.scale.log()[:, None]
    found = Estimate(pose.rotation, pose.translation, pose.scale.log(), log_depths)
    nothing = torch.zeros_like(log_depths)
    return Adjusted(found, nothing.sum((1, 2)), nothing, nothing)


def _adjusted(
    prediction: PairPrediction, confidence: Float[Tensor, "batch 2 h w"], intrinsics: Float[Tensor, "batch 2 3 3"]
) -> Adjusted:
    """The best of several starts: Procrustes, and turns about the middle of what view 0 sees."""
    weighted = replace(prediction, confidence_logits=torch.logit(confidence, eps=1e-6))
    pose = pose_by_procrustes(weighted, intrinsics)
    depth = prediction.log_depths[:, 0].flatten(1).median(1).values.exp()
    starts = [(pose.rotation, pose.translation, pose.scale), *(_orbit(turn, depth) for turn in TURNS)]
    rotations, shifts, scales = (torch.stack(parts, 1).flatten(0, 1) for parts in zip(*starts))
    evidence = evidence_of(
        prediction.coordinates, confidence, prediction.log_depths, prediction.log_spread.exp(), intrinsics
    )
    count = len(starts)
    several = Evidence(*(value.repeat_interleave(count, 0) for value in vars(evidence).values()))
    return best_of(adjust(several, start_at(several, rotations, shifts, scales)), count)


def _orbit(
    degrees: float, depth: Float[Tensor, "batch"]
) -> tuple[Float[Tensor, "batch 3 3"], Float[Tensor, "batch 3"], Float[Tensor, "batch"]]:
    """Rotation, translation and depth scale of a view 1 that has gone around a point straight ahead of view 0."""
    axis = depth.new_tensor([0.0, math.radians(degrees), 0.0])
    rotation = torch.linalg.matrix_exp(cross_matrix(axis)).expand(len(depth), 3, 3)
    ahead = depth[:, None] * depth.new_tensor([0.0, 0.0, 1.0])
    return rotation, ahead - (rotation @ ahead[..., None])[..., 0], torch.ones_like(depth)


def _completed(
    prior: Float[Tensor, "batch 2 h w"],
    found: Float[Tensor, "batch 2 h w"],
    information: Float[Tensor, "batch 2 h w"],
    images: Float[Tensor, "batch 2 3 height width"],
) -> Float[Tensor, "batch 2 h w"]:
    """Spread the corrections of predicted log depth along the image's edges from where matches told them."""
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


def _smooth(
    values: Float[np.ndarray, "h w"], weights: Float[np.ndarray, "h w"], guide: UInt8[np.ndarray, "h w 3"]
) -> Float[np.ndarray, "h w"]:
    """Weighted mean along the image's edges, never beyond what went in; 0 far from any weight."""
    smoother = cv2.ximgproc.createFastGlobalSmootherFilter(guide, REACH, COLOUR)
    total = smoother.filter(weights + np.float32(1e-3))
    # The two filtered maps lose precision where hardly any weight reaches, and their ratio with it.
    return np.clip(smoother.filter(values * weights) / np.maximum(total, 1e-6), values.min(), values.max())


def _matrix(rotation: Float[Tensor, "batch 3 3"], translation: Float[Tensor, "batch 3"]) -> Float[Tensor, "batch 4 4"]:
    c2w = torch.eye(4, dtype=rotation.dtype, device=rotation.device).repeat(len(rotation), 1, 1)
    c2w[:, :3, :3], c2w[:, :3, 3] = rotation, translation
    return c2w
