"""From the search in a window to one match, its confidence and a depth per fine cell."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r_matching_network.soft_matching import REACH, WINDOW, WindowMatches

USUAL_LOG_DEPTH = 0.7
"""Depth 2: where an untrained network begins."""


@dataclass(frozen=True)
class FineMaps:
    """Outputs at stride 2 for B pairs."""

    places: Float[Tensor, "batch 2 height width 2"]
    confidence_logits: Float[Tensor, "batch 2 height width"]
    log_depths: Float[Tensor, "batch 2 height width"]
    log_spread: Float[Tensor, "batch 2 height width"]


class FineDecoder(nn.Module):
    """Two spatial convolutions; the match is the window's expectation plus a correction that starts at 0."""

    def __init__(self, width: int, fine_width: int, hidden: int = 32) -> None:
        super().__init__()
        self.window = nn.Conv2d(WINDOW + 4 + fine_width, hidden, 1)
        self.token = nn.Conv2d(width, hidden, 1)
        self.mix = nn.Sequential(
            nn.SiLU(),
            nn.Conv2d(hidden, hidden, 3, padding=1),
            nn.GroupNorm(8, hidden),
            nn.SiLU(),
            nn.Conv2d(hidden, hidden, 3, padding=2, dilation=2),
            nn.GroupNorm(8, hidden),
            nn.SiLU(),
        )
        self.out = nn.Conv2d(hidden, 5, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(
        self,
        fine: Float[Tensor, "picture channel height width"],
        maps: Float[Tensor, "picture channel2 height4 width4"],
        corrected: Float[Tensor, "picture 2 height4 width4"],
        window: WindowMatches,
        grid: tuple[int, int],
    ) -> FineMaps:
        size = torch.tensor(grid[::-1], dtype=fine.dtype, device=fine.device)
        found = _as_maps(window.places, grid)
        around = F.interpolate(corrected, grid, mode="bilinear", align_corners=False)
        from_middle = window.places * size - (window.corners + REACH / 2)
        gap = (found - around) * size[:, None, None]
        seen = torch.cat((_as_maps(window.logits.clamp(min=-20) / 10, grid), _as_maps(from_middle, grid), gap), 1)
        tokens = F.interpolate(self.token(maps), grid, mode="bilinear", align_corners=False)
        out = self.out(self.mix(self.window(torch.cat((seen, fine), 1)) + tokens))
        shift, confidence, depth, spread = out.unflatten(0, (-1, 2)).split((2, 1, 1, 1), 2)
        places = window.places.unflatten(2, grid) + shift.movedim(2, -1) / size
        return FineMaps(
            places,
            confidence[:, :, 0],
            USUAL_LOG_DEPTH + depth[:, :, 0].clamp(-4, 4),
            spread[:, :, 0].clamp(-3, 3) - 1,
        )


def _as_maps(cells: Tensor, grid: tuple[int, int]) -> Tensor:
    """`[batch, 2, cell, channel]` to `[batch * 2, channel, height, width]`."""
    return cells.flatten(0, 1).transpose(1, 2).unflatten(-1, grid)
