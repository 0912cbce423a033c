"""Two-dimensional rotary position embedding of CroCo-style transformers.

Half of each head's channels turn with the token's row, half with its column. Inside a half, channel j is paired with
channel j + d/4 (not with its neighbour), and the pair turns by `position * base^(-4j/d)`, d being the head width.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Complex, Float, Int
from torch import Tensor


@dataclass(frozen=True)
class Rotation:
    """Tables for one sequence of tokens, one value per channel so that they multiply whole heads at once."""

    cos: Float[Tensor, "token 1 channel"]
    sin: Float[Tensor, "token 1 channel"]  # negative for the first of each pair
    turns: Complex[Tensor, "token 1 channel/2"]  # the same, one per pair

    def __call__(self, x: Float[Tensor, "batch token head channel"]) -> Float[Tensor, "batch token head channel"]:
        """Turn queries or keys; dtype of `x` is kept."""
        partners = x.unflatten(-1, (2, 2, -1)).flip(-2).flatten(-3)
        return torch.addcmul(x * self.cos.to(x.dtype), partners, self.sin.to(x.dtype))

    def adjacent(self, x: Float[Tensor, "batch token head channel"]) -> Float[Tensor, "batch token head channel"]:
        """The same for float32 channels in `adjacent_order`: one complex product, several times as fast."""
        pairs = torch.view_as_complex(x.unflatten(-1, (-1, 2)))
        return torch.view_as_real(pairs * self.turns).flatten(-2)


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
    angles = positions.double()[:, None, :, None, None] * frequencies  # [token, 1, axis, 1, pair]
    cos = angles.cos().expand(-1, -1, -1, 2, -1)
    sin = torch.cat((-angles.sin(), angles.sin()), -2)
    turns = torch.complex(angles.cos(), angles.sin()).flatten(2)
    return Rotation(*(table.flatten(2).float().to(device) for table in (cos, sin)), turns.cfloat().to(device))


def adjacent_order(head_width: int) -> Int[Tensor, "channel"]:
    """The channels of a head, reordered so that the two of a pair stand side by side."""
    return torch.arange(head_width).view(2, 2, -1).transpose(1, 2).flatten()
