"""Weighted similarity between two point sets in closed form, with gradients that stay finite."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

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
        moved = points @ self.rotation.transpose(1, 2)
        return self.scale[:, None, None] * moved + self.translation[:, None]


def robust_similarity(
    source: Float[Tensor, "batch point 3"],
    target: Float[Tensor, "batch point 3"],
    weights: Float[Tensor, "batch point"],
) -> Similarity:
    """Iteratively reweighted (Cauchy) fit; the reweighting itself is not differentiated."""
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
    """Least squares after Umeyama (1991), differentiable in all three; computed in double precision."""
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


def cross_matrix(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """[v]x, so that [v]x w is the cross product of v and w."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    rows = (torch.stack((zero, -z, y), -1), torch.stack((z, zero, -x), -1), torch.stack((-y, x, zero), -1))
    return torch.stack(rows, -2)
