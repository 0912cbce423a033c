"""SAM2's automatic mask generator: ask for three masks at every point of a grid, keep the sure and stable ones."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.reporting import progress
from edit3r_segmenters.candidates import Candidates, describe, suppress
from edit3r_segmenters.preprocess import enlarge


def point_grid(per_side: int) -> Float[Tensor, "point 2"]:
    """x, y of the centres of per_side x per_side cells, in [0, 1], row by row."""
    centres = (torch.arange(per_side) + 0.5) / per_side
    y, x = torch.meshgrid(centres, centres, indexing="ij")
    return torch.stack((x, y), dim=-1).flatten(0, 1)


def find_candidates(
    model: Any,
    embeddings: list[Tensor],
    image_size: tuple[int, int],
    per_side: int,
    batch: int,
    min_iou: float,
    min_stability: float,
    max_overlap: float,
) -> Candidates:
    """The masks of one picture that pass both quality bounds and no better one's box covers, best first."""
    side = model.config.prompt_encoder_config.image_size
    points = point_grid(per_side).to(embeddings[0]) * side
    found: list[Candidates] = []
    for start in range(0, len(points), batch):
        found.append(_at_points(model, embeddings, image_size, points[start : start + batch], min_iou, min_stability))
        progress("segmenting", min(start + batch, len(points)), len(points))
    every = Candidates.cat(found)
    return every.select(torch.tensor(suppress(every.boxes, every.predicted_iou, max_overlap), dtype=torch.long))


def _at_points(
    model: Any,
    embeddings: list[Tensor],
    image_size: tuple[int, int],
    points: Float[Tensor, "point 2"],
    min_iou: float,
    min_stability: float,
) -> Candidates:
    """Good masks of a few points; only the small logits are kept, large pictures would fill the memory."""
    output = model(image_embeddings=embeddings, input_points=points[None, :, None], multimask_output=True)
    logits, iou = output.pred_masks[0].flatten(0, 1), output.iou_scores[0].flatten()
    sure = iou >= min_iou
    fields = describe(logits[sure], enlarge(logits[sure], image_size), iou[sure])
    return fields.select((fields.stability >= min_stability) & (fields.area > 0))
