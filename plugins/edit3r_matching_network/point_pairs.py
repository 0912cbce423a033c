"""From matches and depths to pairs of 3D points, and from those to view 1's pose."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.alignment import Similarity, robust_similarity
from edit3r.geometry.cameras import pixel_grid, pixel_rays
from edit3r_matching_network.network import PairPrediction


@dataclass(frozen=True)
class PointPairs:
    """The same N points of B scenes as either view sees them, each in its own camera's frame."""

    first: Float[Tensor, "batch point 3"]
    second: Float[Tensor, "batch point 3"]
    weights: Float[Tensor, "batch point"]  # >= 0


def point_pairs(prediction: PairPrediction, intrinsics: Float[Tensor, "batch 2 3 3"], every: int = 1) -> PointPairs:
    """Every `every`-th cell (along both axes) of view 1 with its match in view 0."""
    part = slice(every // 2, None, every)
    log_depths = prediction.log_depths[:, 1, part, part]
    places = prediction.places[:, 1, part, part]
    rays = pixel_rays(intrinsics[:, 1], prediction.log_depths.shape[-2:])[:, part, part]
    second = rays * log_depths.exp()[..., None]
    first = rays_at(places, intrinsics[:, 0]) * _sampled(prediction.log_depths[:, 0], places).exp()[..., None]
    weights = torch.sigmoid(prediction.confidence_logits[:, 1, part, part]) * (-log_depths.detach()).exp()
    return PointPairs(first.flatten(1, 2), second.flatten(1, 2), weights.flatten(1))


def pose_by_procrustes(
    prediction: PairPrediction, intrinsics: Float[Tensor, "batch 2 3 3"], every: int = 1
) -> Similarity:
    """What takes points of view 1's camera into view 0's; its scale is what view 1's depths are to be multiplied by."""
    pairs = point_pairs(prediction, intrinsics, every)
    return robust_similarity(pairs.second, pairs.first, pairs.weights)


def rays_at(
    places: Float[Tensor, "batch height width 2"], intrinsics: Float[Tensor, "batch 3 3"]
) -> Float[Tensor, "batch height width 3"]:
    """Camera-frame vectors with z = 1 through normalised picture coordinates."""
    homogeneous = torch.cat((places, torch.ones_like(places[..., :1])), -1)
    return torch.einsum("bij,bhwj->bhwi", torch.linalg.inv(intrinsics), homogeneous)


def cycle_error(places: Float[Tensor, "batch 2 height width 2"]) -> Float[Tensor, "batch 2 height width"]:
    """How far from its start a cell ends that goes to the other view and back along the matches [cells]."""
    grid = places.shape[2:4]
    there = places.flatten(0, 1) * 2 - 1
    back = places.flip(1).flatten(0, 1).movedim(-1, 1)
    back = F.grid_sample(back, there, padding_mode="border", align_corners=False).movedim(1, -1)
    size = places.new_tensor(grid[::-1])
    return ((back.view_as(places) - pixel_grid(grid, places)) * size).norm(dim=-1)


def _sampled(maps: Float[Tensor, "batch height width"], places: Tensor) -> Float[Tensor, "batch height2 width2"]:
    return F.grid_sample(maps[:, None], places * 2 - 1, padding_mode="border", align_corners=False)[:, 0]
