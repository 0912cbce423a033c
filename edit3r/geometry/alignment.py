"""Alignment of two reconstructions of one scene: similarity transforms and ratios of lengths."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.rotations import cross_matrix

__all__ = [
    "Similarity",
    "median_scale",
    "nearest_rotation",
    "robust_similarity",
    "weighted_similarity",
]

ROUNDS = 5
TOLERANCE = 0.06
"""Residual, relative to a point's distance, at which its weight falls to a half."""


@dataclass(frozen=True)
class Similarity:
    """target = scale * rotation @ source + translation."""

    scale: Float[Tensor, "batch"]
    rotation: Float[Tensor, "batch 3 3"]
    translation: Float[Tensor, "batch 3"]

    def apply(self, points: Float[Tensor, "batch point 3"]) -> Float[Tensor, "batch point 3"]:
        """The transformed points."""
        moved = points @ self.rotation.transpose(1, 2)
        return self.scale[:, None, None] * moved + self.translation[:, None]


def robust_similarity(
    source: Float[Tensor, "batch point 3"],
    target: Float[Tensor, "batch point 3"],
    weights: Float[Tensor, "batch point"],
) -> Similarity:
    """The similarity from `source` to `target` that outliers hardly move.

    Iteratively reweighted (Cauchy) least squares; the reweighting itself is not differentiated. `weights` >= 0.
    """
    distance = target.detach().norm(dim=-1).clamp(min=1e-6)
    factor = torch.ones_like(weights)
    with torch.no_grad():
        for _ in range(ROUNDS):
            fit = weighted_similarity(source, target, weights * factor)
            residual = (fit.apply(source) - target).norm(dim=-1) / distance
            factor = 1 / (1 + (residual / TOLERANCE).square())
    return weighted_similarity(source, target, weights * factor)


def weighted_similarity(
    source: Float[Tensor, "batch point 3"],
    target: Float[Tensor, "batch point 3"],
    weights: Float[Tensor, "batch point"],
) -> Similarity:
    """The similarity that takes `source` to `target` with least squares, after Umeyama (1991).

    Differentiable in all three arguments, with gradients that stay finite; computed in double precision.
    """
    dtype = source.dtype
    source, target, weights = source.double(), target.double(), weights.double() + 1e-12
    share = (weights / weights.sum(1, keepdim=True))[..., None]
    source_mean, target_mean = (share * source).sum(1), (share * target).sum(1)
    a, b = source - source_mean[:, None], target - target_mean[:, None]
    covariance = (share * b).transpose(1, 2) @ a
    rotation = nearest_rotation(covariance)
    spread = (share * a.square()).sum((1, 2))
    scale = (rotation * covariance).sum((1, 2)).clamp(min=1e-9) / spread.clamp(min=1e-9)
    translation = target_mean - scale[:, None] * (rotation @ source_mean[..., None])[..., 0]
    return Similarity(scale.to(dtype), rotation.to(dtype), translation.to(dtype))


def nearest_rotation(matrix: Float[Tensor, "batch 3 3"]) -> Float[Tensor, "batch 3 3"]:
    """The rotation R with the largest trace of R^T `matrix`.

    Its derivative comes from the condition that R^T matrix is symmetric, not from the factors of the singular value
    decomposition, which have none where singular values coincide: moving R by exp([w]x) changes that condition by
    (tr(S) I - S) w with S = R^T matrix.
    """
    with torch.no_grad():
        u, _, vt = torch.linalg.svd(torch.nan_to_num(matrix))  # what is not finite shows up in the derivative
        sign = torch.ones(matrix.shape[:-1], dtype=matrix.dtype, device=matrix.device)
        sign[..., 2] = torch.where(torch.linalg.det(u @ vt) < 0, -1.0, 1.0)
        rotation = (u * sign[..., None, :]) @ vt
        s = rotation.transpose(1, 2) @ matrix
        trace = s.diagonal(dim1=1, dim2=2).sum(-1)[:, None, None]
        eye = torch.eye(3, dtype=matrix.dtype, device=matrix.device)
        stiffness = trace * eye - 0.5 * (s + s.transpose(1, 2)) + (1e-9 * trace.abs() + 1e-12) * eye
    if not matrix.requires_grad:
        return rotation
    moving = rotation.transpose(1, 2) @ matrix
    skew = moving - moving.transpose(1, 2)
    turn = torch.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), -1)
    turn = torch.linalg.solve(stiffness, (turn - turn.detach())[..., None])[..., 0]  # 0 in value
    return rotation + rotation @ cross_matrix(turn)


def median_scale(source: Float[Tensor, "point 3"], target: Float[Tensor, "point 3"]) -> Float[Tensor, ""]:
    """The factor by which `source` becomes as large as `target`: the median ratio of distances from the origin.

    Both hold the same points (or camera centres) in frames with one origin; 1 for no points.
    """
    if len(source) == 0:
        return target.new_ones(())
    return (target.norm(dim=-1) / source.norm(dim=-1).clamp(min=1e-12)).median()
