"""Soft correlation: probabilities that tokens of two views show the same point, over the whole view or a window."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int, Shaped
from torch import Tensor

REACH = 8
"""Side of the fine search's window [fine cells]; its middle is the coarse match."""
WINDOW = REACH**2
CELLS = 4
"""Fine cells of a token, two by two; they share a window."""


@dataclass(frozen=True)
class GlobalMatches:
    """Per token of each view, where in the other view it is."""

    log_probabilities: Float[Tensor, "batch 2 token token2"]  # over the other view's tokens
    coordinates: Float[Tensor, "batch 2 token 2"]  # expected (x, y), normalised
    carried: Float[Tensor, "batch 2 token channel"]  # the other view's features at the match
    certainty: Float[Tensor, "batch 2 token 2"]  # highest probability; entropy over that of knowing nothing


@dataclass(frozen=True)
class WindowMatches:
    """Per fine cell of each view, the search around a coarse match; cells are row-major."""

    corners: Int[Tensor, "batch 2 cell 2"]  # (column, row) of the window's first cell in the other view
    logits: Float[Tensor, "batch 2 cell window"]  # row-major in the window; very low outside the image
    coordinates: Float[Tensor, "batch 2 cell 2"]  # expected (x, y), normalised


def match_globally(
    descriptors: Float[Tensor, "batch 2 token dim"],
    features: Float[Tensor, "batch 2 token channel"],
    bias: Float[Tensor, "batch token token"],
    coordinates: Float[Tensor, "token 2"],
) -> GlobalMatches:
    """Softmax both ways over all pairs; `bias` [view 0's token, view 1's] is what is known without looking."""
    logits = descriptors[:, 0] @ descriptors[:, 1].transpose(1, 2) + bias
    log_p = torch.stack((logits.log_softmax(-1), logits.transpose(1, 2).log_softmax(-1)), 1)
    p = log_p.exp()
    entropy = -(p * log_p).sum(-1) / torch.log(torch.tensor(float(p.shape[-1])))
    return GlobalMatches(
        log_probabilities=log_p,
        coordinates=p @ coordinates,
        carried=p @ features.flip(1),
        certainty=torch.stack((p.amax(-1), entropy), -1),
    )


def match_in_window(
    descriptors: Float[Tensor, "batch 2 dim height width"], around: Float[Tensor, "batch 2 token 2"]
) -> WindowMatches:
    """Search near the coordinates `around` (normalised, in the other view) of the tokens, each of 2 x 2 cells."""
    height, width = descriptors.shape[-2:]
    grid = (height // 2, width // 2)
    size = torch.tensor((width, height), device=around.device)
    middle = (around.detach() * size).round().long()
    corners = torch.minimum(middle.clamp(min=0), size) - REACH // 2
    cells = corners[..., None, :] + window_offsets(around.device)  # [batch, 2, token, window, 2]
    inside = ((cells >= 0) & (cells < size)).all(-1)
    column, row = torch.minimum(cells.clamp(min=0), size - 1).unbind(-1)
    keys = _gathered(descriptors.flip(1), row * width + column)
    logits = (keys @ _queries(descriptors)).masked_fill(~inside[..., None], -1e4)  # [batch, 2, token, window, 4]
    logits = _by_cell(logits.transpose(-1, -2), grid)
    corners = _by_cell(corners[..., None, :].expand(-1, -1, -1, CELLS, -1), grid)
    offsets = window_offsets(around.device).to(logits.dtype)
    return WindowMatches(corners, logits, (corners + logits.softmax(-1) @ offsets + 0.5) / size)


def window_offsets(device: torch.device | None = None) -> Int[Tensor, "window 2"]:
    """(column, row) offsets of the window's cells from its first, row-major."""
    line = torch.arange(REACH, device=device)
    return torch.stack(torch.meshgrid(line, line, indexing="xy"), -1).reshape(-1, 2)


def _gathered(
    descriptors: Float[Tensor, "batch 2 dim height width"], cells: Int[Tensor, "batch 2 token window"]
) -> Float[Tensor, "batch 2 token window dim"]:
    """Descriptors of the cells with the given numbers, counted row by row."""
    rows = descriptors.flatten(0, 1).flatten(2).transpose(1, 2)  # [image, cell, dim]
    first = torch.arange(len(rows), device=cells.device)[:, None, None] * rows.shape[1]
    numbers = cells.flatten(0, 1) + first
    return F.embedding(numbers, rows.flatten(0, 1)).unflatten(0, cells.shape[:2])


def _queries(descriptors: Float[Tensor, "batch 2 dim height width"]) -> Float[Tensor, "batch 2 token dim 4"]:
    """Descriptors of the four cells of each token."""
    parted = F.pixel_unshuffle(descriptors.flatten(0, 1), 2)  # [image, dim * 4, rows, columns]
    parted = parted.unflatten(1, (-1, CELLS)).flatten(3)
    return parted.permute(0, 3, 1, 2).unflatten(0, descriptors.shape[:2])


def _by_cell(values: Shaped[Tensor, "batch 2 token 4 c"], grid: tuple[int, int]) -> Shaped[Tensor, "batch 2 cell c"]:
    """Values of the tokens' cells, row by row over all fine cells; `grid` is that of the tokens."""
    split = values.unflatten(3, (2, 2)).unflatten(2, grid)  # [batch, 2, rows, columns, 2, 2, channel]
    return split.permute(0, 1, 2, 4, 3, 5, 6).flatten(2, 5)


def unit_descriptors(
    features: Float[Tensor, "*shape"], dim: int, log_sharpness: Float[Tensor, ""]
) -> Float[Tensor, "*shape"]:
    """Unit vectors along `dim`, scaled so that a product of two is a logit of at most `exp(log_sharpness)`."""
    return F.normalize(features, dim=dim, eps=1e-6) * (0.5 * log_sharpness).exp()
