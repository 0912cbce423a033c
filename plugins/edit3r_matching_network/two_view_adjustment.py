"""Two-view adjustment: the pose and depths that agree best with the matches and with the predicted depths.

Levenberg-Marquardt on view 1's pose (6), the scale between the two views' depth predictions (1) and every cell's log
depth, which is eliminated first (Schur complement; Triggs et al. 2000, "Bundle adjustment - a modern synthesis").
Matches pull robustly (Cauchy) in the image plane, so an error of predicted depth hurts the pose far less than
in a fit of 3D points; predicted depths hold what matches cannot tell. Not differentiable.
"""

from dataclasses import dataclass
from typing import TypeVar

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import pixel_rays
from edit3r.geometry.rotations import cross_matrix

SPREADS = (1.0, 0.25)
"""Standard error of a good match [cells]: first a generous one, which reaches further, then a tight one."""
DOUBTFUL = 2.0
"""Error at which the weight of a match or of a predicted depth falls to a half [its own spread]."""
HOPELESS = 40.0
"""Loss of a match that lies behind the other camera."""
LEAST_SPREAD = 0.04
"""A depth prediction is never trusted to be nearer than this [log]."""
POSE, SCALE = slice(0, 6), 6
Fields = TypeVar("Fields", "Estimate", "_Linearised")


@dataclass(frozen=True)
class Evidence:
    """What N cells of each of two views say; all lengths in the unit of the predicted depths."""

    rays: Float[Tensor, "batch 2 cell 3"]  # own camera's frame, z = 1
    seen: Float[Tensor, "batch 2 cell 2"]  # x/z, y/z of the match in the other camera's frame
    focal: Float[Tensor, "batch 2 1 2"]  # of the other camera [cells]
    weights: Float[Tensor, "batch 2 cell"]  # of the matches, in [0, 1]
    prior: Float[Tensor, "batch 2 cell"]  # predicted log depth
    spread: Float[Tensor, "batch 2 cell"]  # its standard error


@dataclass(frozen=True)
class Estimate:
    """What is adjusted."""

    rotation: Float[Tensor, "batch 3 3"]  # of view 1, camera to world
    translation: Float[Tensor, "batch 3"]
    log_scale: Float[Tensor, "batch"]  # of view 1's predicted depths
    log_depths: Float[Tensor, "batch 2 cell"]


@dataclass(frozen=True)
class Adjusted:
    """The best estimate and how well each match fits it."""

    estimate: Estimate
    cost: Float[Tensor, "batch"]
    residuals: Float[Tensor, "batch 2 cell"]  # [cells]; infinite behind the other camera
    information: Float[Tensor, "batch 2 cell"]  # of the matches on log depth [1 / log^2]


@dataclass(frozen=True)
class _Linearised:
    """Residuals and derivatives at an estimate, already weighted."""

    cost: Float[Tensor, "batch"]
    residuals: Float[Tensor, "batch 2 cell"]
    information: Float[Tensor, "batch 2 cell"]
    pose_matrix: Float[Tensor, "batch 7 7"]
    pose_vector: Float[Tensor, "batch 7"]
    mixed: Float[Tensor, "batch 2 cell 7"]
    depth_matrix: Float[Tensor, "batch 2 cell"]
    depth_vector: Float[Tensor, "batch 2 cell"]


@torch.no_grad()
def adjust(evidence: Evidence, start: Estimate, rounds: int = 8) -> Adjusted:
    """Improve `start`, `rounds` times for each of SPREADS."""
    found = start
    for match_spread in SPREADS:
        found, at = _descend(evidence, found, match_spread, rounds)
    return Adjusted(found, at.cost, at.residuals, at.information)


def _descend(evidence: Evidence, start: Estimate, match_spread: float, rounds: int) -> tuple[Estimate, _Linearised]:
    """Levenberg-Marquardt: a step that raises the cost is taken back and tried again with more damping."""
    current, best = start, _linearise(evidence, start, match_spread)
    damping = torch.full_like(start.log_scale, 1e-3)
    for _ in range(rounds):
        moved = _moved(current, best, damping)
        found = _linearise(evidence, moved, match_spread)
        better = found.cost < best.cost
        current, best = _where(better, moved, current), _where(better, found, best)
        damping = torch.where(better, damping * 0.3, damping * 10).clamp(1e-6, 1e4)
    return current, best


def evidence_of(
    coordinates: Float[Tensor, "batch 2 height width 2"],
    weights: Float[Tensor, "batch 2 height width"],
    log_depths: Float[Tensor, "batch 2 height width"],
    spread: Float[Tensor, "batch 2 height width"],
    intrinsics: Float[Tensor, "batch 2 3 3"],
) -> Evidence:
    """The evidence in double precision; `coordinates` are the matches, normalised (x, y) in the other view."""
    grid = weights.shape[-2:]
    other = intrinsics.flip(1).double()
    seen = torch.stack([rays_through(coordinates[:, view].double(), other[:, view])[..., :2] for view in range(2)], 1)
    focal = other.diagonal(dim1=-2, dim2=-1)[:, :, None, :2] * other.new_tensor((grid[1], grid[0]))
    return Evidence(
        pixel_rays(intrinsics.double(), grid).flatten(2, 3),
        seen.flatten(2, 3),
        focal,
        weights.double().flatten(2),
        log_depths.double().flatten(2),
        spread.double().flatten(2).clamp(min=LEAST_SPREAD),
    )


def rays_through(
    coordinates: Float[Tensor, "batch height width 2"], intrinsics: Float[Tensor, "batch 3 3"]
) -> Float[Tensor, "batch height width 3"]:
    """Camera-frame vectors with z = 1 through normalised image coordinates (x, y)."""
    homogeneous = torch.cat((coordinates, torch.ones_like(coordinates[..., :1])), -1)
    return torch.einsum("bij,bhwj->bhwi", torch.linalg.inv(intrinsics), homogeneous)


def start_at(
    evidence: Evidence,
    rotation: Float[Tensor, "batch 3 3"],
    translation: Float[Tensor, "batch 3"],
    scale: Float[Tensor, "batch"],
) -> Estimate:
    """The estimate with the given pose and the predicted depths; `scale` is that of view 1's depths."""
    log_scale = scale.double().clamp(min=1e-6).log()
    log_depths = evidence.prior + torch.stack((torch.zeros_like(log_scale), log_scale), 1)[..., None]
    return Estimate(rotation.double(), translation.double(), log_scale, log_depths)


def _linearise(evidence: Evidence, at: Estimate, match_spread: float) -> _Linearised:
    """The Gauss-Newton system at an estimate, where a good match has a standard error of `match_spread` [cells]."""
    points = evidence.rays * at.log_depths.exp()[..., None]
    turns = torch.stack((at.rotation.transpose(1, 2), at.rotation), 1)  # own camera to the other's
    turned = torch.einsum("bvij,bvnj->bvni", turns, points)
    shift = torch.stack((-torch.einsum("bji,bj->bi", at.rotation, at.translation), at.translation), 1)
    there = turned + shift[:, :, None]  # in the other camera's frame
    in_front = there[..., 2] > 1e-3
    z = there[..., 2].clamp(min=1e-3)
    focal = evidence.focal / match_spread
    error = (there[..., :2] / z[..., None] - evidence.seen) * focal
    squared = error.square().sum(-1)
    weights = evidence.weights * in_front / (1 + squared / DOUBTFUL**2)

    by_point = _projection_derivative(there, z, focal)  # [batch, 2, cell, 2, 3]
    by_pose = by_point @ _pose_derivative(at, points, there)  # [batch, 2, cell, 2, 6]
    by_depth = (by_point @ turned[..., None])[..., 0]

    scales = torch.stack((torch.zeros_like(at.log_scale), at.log_scale), 1)[..., None]
    off = (at.log_depths - evidence.prior - scales) / evidence.spread
    cost = evidence.weights * torch.where(in_front, _robust(squared), HOPELESS) + _robust(off.square())
    trust = 1 / (1 + (off / DOUBTFUL).square()) / evidence.spread.square()
    off = off * evidence.spread

    information = weights * by_depth.square().sum(-1)
    mixed = torch.cat((weights[..., None] * torch.einsum("bvnki,bvnk->bvni", by_pose, by_depth), -trust[..., None]), -1)
    mixed[:, 0, :, SCALE] = 0
    pose_matrix = torch.zeros(len(points), 7, 7, dtype=points.dtype, device=points.device)
    weighted = by_pose * weights[..., None, None]
    pose_matrix[:, POSE, POSE] = torch.einsum("bvnki,bvnkj->bij", weighted, by_pose)
    pose_matrix[:, SCALE, SCALE] = trust[:, 1].sum(-1)
    pose_vector = torch.cat(
        (torch.einsum("bvnki,bvnk->bi", weighted, error), -(trust * off)[:, 1].sum(-1, keepdim=True)), -1
    )
    return _Linearised(
        cost.sum((1, 2)),
        torch.where(in_front, squared.sqrt() * match_spread, torch.inf),
        information,
        pose_matrix,
        pose_vector,
        mixed,
        information + trust,
        weights * (by_depth * error).sum(-1) + trust * off,
    )


def _robust(squared: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Cauchy's loss of a squared error [spreads]."""
    return DOUBTFUL**2 * torch.log1p(squared / DOUBTFUL**2)


def _projection_derivative(
    points: Float[Tensor, "batch 2 cell 3"], z: Float[Tensor, "batch 2 cell"], focal: Float[Tensor, "batch 2 1 2"]
) -> Float[Tensor, "batch 2 cell 2 3"]:
    """Derivative of (x/z, y/z) times `focal` by the point."""
    zero = torch.zeros_like(z)
    across = torch.stack((1 / z, zero, -points[..., 0] / z**2), -1)
    down = torch.stack((zero, 1 / z, -points[..., 1] / z**2), -1)
    return torch.stack((across, down), -2) * focal[..., None]


def _pose_derivative(
    at: Estimate, points: Float[Tensor, "batch 2 cell 3"], there: Float[Tensor, "batch 2 cell 3"]
) -> Float[Tensor, "batch 2 cell 3 6"]:
    """Derivative of points in the other camera's frame by (w, v), which move view 1's pose T to T exp(w, v)."""
    eye = torch.eye(3, dtype=points.dtype, device=points.device).expand(*points.shape[:1], points.shape[2], 3, 3)
    first = torch.cat((cross_matrix(there[:, 0]), -eye), -1)
    second = at.rotation[:, None] @ torch.cat((-cross_matrix(points[:, 1]), eye), -1)
    return torch.stack((first, second), 1)


def _moved(at: Estimate, system: _Linearised, damping: Float[Tensor, "batch"]) -> Estimate:
    """One damped step; log depths move by at most 0.5, the pose by at most 0.3."""
    depth_matrix = system.depth_matrix * (1 + damping[:, None, None])
    ratio = system.mixed / depth_matrix[..., None]
    matrix = system.pose_matrix - torch.einsum("bvni,bvnj->bij", ratio, system.mixed)
    vector = system.pose_vector - torch.einsum("bvni,bvn->bi", ratio, system.depth_vector)
    diagonal = system.pose_matrix.diagonal(dim1=1, dim2=2) * damping[:, None] + 1e-9
    step = -torch.linalg.solve(matrix + torch.diag_embed(diagonal), vector[..., None])[..., 0]
    step = step / (step.abs().amax(-1, keepdim=True) / 0.3).clamp(min=1)
    depth_step = -(system.depth_vector + torch.einsum("bvni,bi->bvn", system.mixed, step)) / depth_matrix
    return Estimate(
        at.rotation @ torch.linalg.matrix_exp(cross_matrix(step[:, :3])),
        at.translation + torch.einsum("bij,bj->bi", at.rotation, step[:, 3:6]),
        at.log_scale + step[:, SCALE],
        at.log_depths + depth_step.clamp(-0.5, 0.5),
    )


def best_of(candidates: Adjusted, count: int) -> Adjusted:
    """The cheapest of `count` successive candidates for each scene."""
    index = candidates.cost.reshape(-1, count).argmin(1)
    index = index + count * torch.arange(len(index), device=index.device)
    found = Estimate(*(value[index] for value in vars(candidates.estimate).values()))
    return Adjusted(found, candidates.cost[index], candidates.residuals[index], candidates.information[index])


def _where(chosen: Bool[Tensor, "batch"], new: Fields, old: Fields) -> Fields:
    """`new` for the chosen scenes, else `old`, field by field."""
    pairs = zip(vars(new).values(), vars(old).values())
    return type(old)(*(torch.where(chosen.reshape(-1, *(1,) * (a.dim() - 1)), a, b) for a, b in pairs))
