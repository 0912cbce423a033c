"""Two-dimensional rotary position embedding of CroCo-style transformers.

Half of each head's channels turn with the token's row, half with its column. Inside a half, channel j is paired with
channel j + d/4 (not with its neighbour), and the pair turns by `position * base^(-4j/d)`, d being the head width.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Rotation:
    """Tables for one sequence of tokens, laid out to broadcast over [batch, token, head, axis, half, pair]."""

    cos: Float[Tensor, "token 1 2 1 pair"]
    sin: Float[Tensor, "token 1 2 2 pair"]  # negative for the first half of each axis

    def __call__(self, x: Float[Tensor, "batch token head channel"]) -> Float[Tensor, "batch token head channel"]:
        """Turn queries or keys; dtype of `x` is kept."""
        halves = x.unflatten(-1, (2, 2, self.cos.shape[-1]))
        cos, sin = self.cos.to(x.dtype), self.sin.to(x.dtype)
        return torch.addcmul(halves * cos, halves.flip(-2), sin).flatten(-3)


def patch_positions(grid: tuple[int, int], extra_token: bool) -> Int[Tensor, "token 2"]:
    """(row, column) of every patch, row-major; an extra token sits at the first cell of the row below the grid."""
    rows, columns = grid
    positions = torch.cartesian_prod(torch.arange(rows), torch.arange(columns)).reshape(-1, 2)
    if not extra_token:
        return positions
    return torch.cat((positions, torch.tensor([[rows, 0]])))


def make_rotation(
    positions: Int[Tensor, "token 2"], head_width: int, base: float, device: torch.device | str = "cpu"
) -> Rotation:
    """Tables for tokens at `positions`; computed in float64, kept in float32."""
    pairs = head_width // 4
    frequencies = base ** (-torch.arange(pairs, dtype=torch.float64) / pairs)
    angles = positions.double()[:, None, :, None, None] * frequencies
    sin = torch.cat((-angles.sin(), angles.sin()), -2)
    return Rotation(angles.cos().float().to(device), sin.float().to(device))
