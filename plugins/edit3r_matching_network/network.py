"""The network from two photos to soft matches, depths and confidences; no pose goes in, none comes out.

photos --> PyramidEncoder --> tokens --ViewBlocks--> descriptors --all pairs--> coarse match
                |                                                                  |
                |                         tokens + carried features + match --ViewBlocks--> corrected match
                +--> fine features ---------- search in a window around it --> FineDecoder --> match, confidence, depth
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.geometry.cameras import pixel_grid, pixel_rays
from edit3r_matching_network.attention import RayEncoding, ViewBlock
from edit3r_matching_network.encoder import FINE_STRIDE, TOKEN_STRIDE, PyramidEncoder
from edit3r_matching_network.fine_decoder import FineDecoder, FineMaps
from edit3r_matching_network.soft_matching import (
    GlobalMatches,
    WindowMatches,
    match_globally,
    match_in_window,
    unit_descriptors,
)

DESCRIPTOR = 48
FINE_DESCRIPTOR = 16


@dataclass(frozen=True)
class PairPrediction:
    """What the network says about B pairs of views; the stages before the last are kept for supervision."""

    coarse: GlobalMatches  # at stride 4
    corrected: Float[Tensor, "batch 2 height4 width4 2"]  # the coarse places after attention, normalised
    window: WindowMatches  # at stride 2
    places: Float[Tensor, "batch 2 height2 width2 2"]  # where each cell lies in the other view, normalised
    confidence_logits: Float[Tensor, "batch 2 height2 width2"]  # of the match being right
    log_depths: Float[Tensor, "batch 2 height2 width2"]  # camera z, unit of length common to both views
    log_spread: Float[Tensor, "batch 2 height2 width2"]  # log of the Laplace scale of log_depths' error


class CorrelationNetwork(nn.Module):
    """About 1.5 million parameters at the default sizes."""

    def __init__(self, width: int = 96, fine_width: int = 32, heads: int = 3, before: int = 0, after: int = 2) -> None:
        super().__init__()
        self.sizes = {"width": width, "fine_width": fine_width, "heads": heads, "before": before, "after": after}
        self.encoder = PyramidEncoder(width, fine_width)
        self.rays = RayEncoding(width)
        self.before = nn.ModuleList([ViewBlock(width, heads, across=True) for _ in range(before)])
        self.describe = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, DESCRIPTOR))
        self.log_sharpness = nn.Parameter(torch.tensor(2.5))
        self.log_nearness = nn.Parameter(torch.tensor(0.0))
        self.combine = nn.Linear(2 * width + 6, width)
        self.after = nn.ModuleList([ViewBlock(width, heads, across=False) for _ in range(after)])
        self.correct = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 2))
        nn.init.zeros_(self.correct[1].weight)
        nn.init.zeros_(self.correct[1].bias)
        self.describe_fine = nn.Conv2d(fine_width, FINE_DESCRIPTOR, 3, padding=1)
        self.describe_around = nn.Conv2d(width, FINE_DESCRIPTOR, 1)
        self.log_fine_sharpness = nn.Parameter(torch.tensor(2.5))
        self.decoder = FineDecoder(width, fine_width)
        self.to(memory_format=torch.channels_last)  # a quarter quicker on a CPU

    def forward(
        self, images: Float[Tensor, "batch 2 3 height width"], intrinsics: Float[Tensor, "batch 2 3 3"]
    ) -> PairPrediction:
        """Images in [0, 1] whose sides are multiples of 8 [pixels], normalised intrinsics."""
        height, width = images.shape[-2:]
        grid = (height // TOKEN_STRIDE, width // TOKEN_STRIDE)
        pyramid = self.encoder(images.flatten(0, 1))
        rays = pixel_rays(intrinsics, grid)[..., :2].flatten(2, 3)  # [batch, 2, token, 2]
        tokens = _as_tokens(pyramid.tokens) + self.rays(rays)
        coarse, tokens = self._match(tokens, rays, intrinsics, grid)
        corrected = coarse.places + 0.1 * self.correct(tokens)
        maps = _as_maps(tokens, grid)
        window = self._search(pyramid.fine, maps, corrected)
        fine_grid = (height // FINE_STRIDE, width // FINE_STRIDE)
        fine = self.decoder(pyramid.fine, maps, _as_maps(corrected, grid), window, fine_grid)
        return _prediction(coarse, corrected.unflatten(2, grid), window, fine)

    def _match(
        self, tokens: Tensor, rays: Tensor, intrinsics: Tensor, grid: tuple[int, int]
    ) -> tuple[GlobalMatches, Tensor]:
        """Coarse matches, and tokens that know them."""
        for block in self.before:
            tokens = block(tokens)
        descriptors = unit_descriptors(self.describe(tokens), -1, self.log_sharpness)
        bias = -self.log_nearness.exp() * torch.cdist(rays[:, 0], rays[:, 1]).square()
        places = pixel_grid(grid, rays).flatten(0, 1)
        coarse = match_globally(descriptors, tokens, bias, places)
        moved = coarse.places - places
        tokens = self.combine(torch.cat((tokens, coarse.carried, 4 * moved, coarse.certainty, rays), -1))
        for block in self.after:
            tokens = block(tokens)
        return coarse, tokens

    def _search(self, fine: Tensor, maps: Tensor, corrected: Tensor) -> WindowMatches:
        """Match fine features around the corrected coarse places."""
        described = self.describe_fine(fine) + _enlarged(self.describe_around(maps), fine)
        descriptors = unit_descriptors(described, 1, self.log_fine_sharpness).unflatten(0, (-1, 2))
        return match_in_window(descriptors, corrected)


def _prediction(coarse: GlobalMatches, corrected: Tensor, window: WindowMatches, fine: FineMaps) -> PairPrediction:
    return PairPrediction(
        coarse, corrected, window, fine.places, fine.confidence_logits, fine.log_depths, fine.log_spread
    )


def _as_tokens(maps: Tensor) -> Tensor:
    """`[batch * 2, channel, height, width]` to `[batch, 2, token, channel]`."""
    return maps.flatten(2).transpose(1, 2).unflatten(0, (-1, 2))


def _as_maps(tokens: Tensor, grid: tuple[int, int]) -> Tensor:
    """Inverse of `_as_tokens`."""
    return tokens.flatten(0, 1).transpose(1, 2).unflatten(-1, grid)


def _enlarged(maps: Tensor, like: Tensor) -> Tensor:
    return F.interpolate(maps, like.shape[-2:], mode="bilinear", align_corners=False)
