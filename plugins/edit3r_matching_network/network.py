"""The network from two images to soft matches, depths and confidences; no pose goes in, none comes out.

images --> PyramidEncoder --> tokens --ViewBlocks--> descriptors --all pairs--> coarse match
                |                                                                  |
                |                         tokens + carried features + match --ViewBlocks--> corrected match
                +--> fine features ---------- search in a window around it --> FineDecoder --> match, confidence, depth
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import safetensors
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r import reporting
from edit3r.errors import InputError
from edit3r.geometry.cameras import pixel_grid, pixel_rays
from edit3r.layers import Conv2d, GroupNorm
from edit3r.training.checkpoint import save_weights
from edit3r_matching_network.encoder import FINE_STRIDE, TOKEN_STRIDE, PyramidEncoder, imagenet_front
from edit3r_matching_network.soft_matching import (
    REACH,
    WINDOW,
    GlobalMatches,
    WindowMatches,
    match_globally,
    match_in_window,
    unit_descriptors,
)

__all__ = ["MatchingNetwork", "PairPrediction", "load_network", "save_network"]

DESCRIPTOR, FINE_DESCRIPTOR = 48, 16  # channels
FREQUENCIES = 6  # octaves of the ray encoding
USUAL_LOG_DEPTH = 0.7  # depth 2: where an untrained network begins
SHIPPED = Path(__file__).parent / "weights" / "correlation.safetensors"


@dataclass(frozen=True)
class PairPrediction:
    """What the network says about B pairs of views; the stages before the last are kept for supervision."""

    coarse: GlobalMatches  # at stride 4
    corrected: Float[Tensor, "batch 2 height4 width4 2"]  # the coarse coordinates after attention, normalised
    window: WindowMatches  # at stride 2
    coordinates: Float[Tensor, "batch 2 height2 width2 2"]  # where each cell lies in the other view, normalised
    confidence_logits: Float[Tensor, "batch 2 height2 width2"]  # of the match being right
    log_depths: Float[Tensor, "batch 2 height2 width2"]  # camera z, unit of length common to both views
    log_spread: Float[Tensor, "batch 2 height2 width2"]  # log of the Laplace scale of log_depths' error


class MatchingNetwork(nn.Module):
    """Matches, depths and confidences of both views of a pair; less than a million parameters by default."""

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
        self.describe_fine = Conv2d(fine_width, FINE_DESCRIPTOR, 3, padding=1)
        self.describe_around = Conv2d(width, FINE_DESCRIPTOR, 1)
        self.log_fine_sharpness = nn.Parameter(torch.tensor(2.5))
        self.decoder = FineDecoder(width, fine_width)
        self.to(memory_format=torch.channels_last)  # a quarter quicker on a CPU

    def forward(
        self, images: Float[Tensor, "batch 2 3 height width"], intrinsics: Float[Tensor, "batch 2 3 3"]
    ) -> PairPrediction:
        """Images in [0, 1] whose sides are multiples of 8 [pixels], normalised intrinsics."""
        height, width = images.shape[-2:]
        grid = (height // TOKEN_STRIDE, width // TOKEN_STRIDE)
        fine, tokens = self.encoder(images.flatten(0, 1))
        rays = pixel_rays(intrinsics, grid)[..., :2].flatten(2, 3)  # [batch, 2, token, 2]
        tokens = _as_tokens(tokens) + self.rays(rays)
        coarse, tokens = self._match(tokens, rays, grid)
        corrected = coarse.coordinates + 0.1 * self.correct(tokens)
        maps = _as_maps(tokens, grid)
        window = self._search(fine, maps, corrected)
        fine_grid = (height // FINE_STRIDE, width // FINE_STRIDE)
        decoded = self.decoder(fine, maps, _as_maps(corrected, grid), window, fine_grid)
        return PairPrediction(coarse, corrected.unflatten(2, grid), window, *decoded)

    def _match(
        self, tokens: Float[Tensor, "batch 2 token c"], rays: Float[Tensor, "batch 2 token 2"], grid: tuple[int, int]
    ) -> tuple[GlobalMatches, Float[Tensor, "batch 2 token c"]]:
        """Coarse matches, and tokens that know them."""
        for block in self.before:
            tokens = block(tokens)
        descriptors = unit_descriptors(self.describe(tokens), -1, self.log_sharpness)
        bias = -self.log_nearness.exp() * torch.cdist(rays[:, 0], rays[:, 1]).square()
        coordinates = pixel_grid(grid, rays).flatten(0, 1)
        coarse = match_globally(descriptors, tokens, bias, coordinates)
        moved = coarse.coordinates - coordinates
        tokens = self.combine(torch.cat((tokens, coarse.carried, 4 * moved, coarse.certainty, rays), -1))
        for block in self.after:
            tokens = block(tokens)
        return coarse, tokens

    def _search(
        self,
        fine: Float[Tensor, "image c height width"],
        maps: Float[Tensor, "image c2 height4 width4"],
        corrected: Float[Tensor, "batch 2 token 2"],
    ) -> WindowMatches:
        """Match fine features around the corrected coarse matches."""
        around = F.interpolate(self.describe_around(maps), fine.shape[-2:], mode="bilinear", align_corners=False)
        descriptors = unit_descriptors(self.describe_fine(fine) + around, 1, self.log_fine_sharpness).unflatten(
            0, (-1, 2)
        )
        return match_in_window(descriptors, corrected)


class FineDecoder(nn.Module):
    """From the search in a window to one match, its confidence and a depth for each fine cell.

    Two spatial convolutions; the match is the window's expectation plus a correction that starts at 0.
    """

    def __init__(self, width: int, fine_width: int, hidden: int = 32) -> None:
        super().__init__()
        self.window = Conv2d(WINDOW + 4 + fine_width, hidden, 1)
        self.token = Conv2d(width, hidden, 1)
        self.mix = nn.Sequential(
            nn.SiLU(),
            Conv2d(hidden, hidden, 3, padding=1),
            GroupNorm(8, hidden),
            nn.SiLU(),
            Conv2d(hidden, hidden, 3, padding=2, dilation=2),
            GroupNorm(8, hidden),
            nn.SiLU(),
        )
        self.out = Conv2d(hidden, 5, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(
        self,
        fine: Float[Tensor, "image channel height width"],
        maps: Float[Tensor, "image channel2 height4 width4"],
        corrected: Float[Tensor, "image 2 height4 width4"],
        window: WindowMatches,
        grid: tuple[int, int],
    ) -> tuple[
        Float[Tensor, "batch 2 height width 2"],
        Float[Tensor, "batch 2 height width"],
        Float[Tensor, "batch 2 height width"],
        Float[Tensor, "batch 2 height width"],
    ]:
        """The last four fields of `PairPrediction` on the fine `grid`."""
        size = torch.tensor(grid[::-1], dtype=fine.dtype, device=fine.device)
        found = _as_maps(window.coordinates, grid)
        around = F.interpolate(corrected, grid, mode="bilinear", align_corners=False)
        from_middle = window.coordinates * size - (window.corners + REACH / 2)
        gap = (found - around) * size[:, None, None]
        seen = torch.cat((_as_maps(window.logits.clamp(min=-20) / 10, grid), _as_maps(from_middle, grid), gap), 1)
        tokens = F.interpolate(self.token(maps), grid, mode="bilinear", align_corners=False)
        out = self.out(self.mix(self.window(torch.cat((seen, fine), 1)) + tokens))
        shift, confidence, depth, spread = out.unflatten(0, (-1, 2)).split((2, 1, 1, 1), 2)
        coordinates = window.coordinates.unflatten(2, grid) + shift.movedim(2, -1) / size
        return (
            coordinates,
            confidence[:, :, 0],
            USUAL_LOG_DEPTH + depth[:, :, 0].clamp(-4, 4),
            spread[:, :, 0].clamp(-3, 3) - 1,
        )


class ViewBlock(nn.Module):
    """Self-attention, attention to the other view if `across`, feed-forward; the same weights for both views."""

    def __init__(self, width: int, heads: int, across: bool, expansion: int = 2) -> None:
        super().__init__()
        self.own = _Attention(width, heads)
        self.other = _Attention(width, heads) if across else None
        self.norm = nn.LayerNorm(width)
        self.feed = nn.Sequential(nn.Linear(width, expansion * width), nn.GELU(), nn.Linear(expansion * width, width))

    def forward(self, tokens: Float[Tensor, "batch 2 token channel"]) -> Float[Tensor, "batch 2 token channel"]:
        tokens = tokens + self.own(tokens, tokens)
        if self.other is not None:
            tokens = tokens + self.other(tokens, tokens.flip(1))
        return tokens + self.feed(self.norm(tokens))


class RayEncoding(nn.Module):
    """Tokens' viewing rays (x/z, y/z) as sines and cosines: the same for any image size and shape."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.project = nn.Linear(2 + 4 * FREQUENCIES, width)

    def forward(self, rays: Float[Tensor, "*batch 2"]) -> Float[Tensor, "*batch channel"]:
        octaves = math.pi * 2.0 ** torch.arange(FREQUENCIES, dtype=rays.dtype, device=rays.device)
        phases = (rays[..., None] * octaves).flatten(-2)
        return self.project(torch.cat((rays, phases.sin(), phases.cos()), -1))


class _Attention(nn.Module):
    """Multi-head attention with its own normalisation; starts by adding little."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.LayerNorm(width)
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.out = nn.Linear(width, width)
        nn.init.normal_(self.out.weight, std=0.2 / math.sqrt(width))

    def forward(
        self, tokens: Float[Tensor, "batch 2 token c"], context: Float[Tensor, "batch 2 token c"]
    ) -> Float[Tensor, "batch 2 token c"]:
        query = self._split(self.query(self.norm(tokens)))
        key, value = self.key_value(self.norm(context)).chunk(2, -1)
        mixed = F.scaled_dot_product_attention(query, self._split(key), self._split(value))
        return self.out(mixed.transpose(1, 2).flatten(2).view_as(tokens))

    def _split(self, x: Float[Tensor, "batch 2 token c"]) -> Float[Tensor, "image head token c2"]:
        """One axis for batch and view, one more for the heads: quick kernels want four axes."""
        return x.flatten(0, 1).unflatten(-1, (self.heads, -1)).transpose(1, 2)


def _as_tokens(maps: Float[Tensor, "image c height width"]) -> Float[Tensor, "batch 2 token c"]:
    """Maps of both views one after the other as tokens, row by row."""
    return maps.flatten(2).transpose(1, 2).unflatten(0, (-1, 2))


def _as_maps(tokens: Float[Tensor, "batch 2 token c"], grid: tuple[int, int]) -> Float[Tensor, "image c height width"]:
    """Inverse of `_as_tokens`."""
    return tokens.flatten(0, 1).transpose(1, 2).unflatten(-1, grid)


MOST_WIDTH = 1024  # and blocks, heads: no file makes the network fill the memory


def load_network(weights: str) -> MatchingNetwork:
    """The network with the weights of a file, or 'shipped', 'untrained' (which is announced) or 'imagenet-front'.

    The last is how a training begins: all but the front is untrained. Raises InputError for any other file.
    """
    if weights == "imagenet-front":
        network = MatchingNetwork()
        network.encoder.front = imagenet_front().to(memory_format=torch.channels_last)
        return network.eval()
    if weights == "untrained":
        reporting.warn("matcher network: the network is untrained; pose and depth are those of a random start.")
        return MatchingNetwork().eval()
    path = SHIPPED if weights == "shipped" else Path(weights)
    sizes, state = _read(path)
    try:
        network = MatchingNetwork(**sizes)
        network.load_state_dict({name: tensor.float() for name, tensor in state.items()})
    except (TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError) as error:
        raise InputError(f"{path}: not weights of this network ({str(error).splitlines()[0]}).") from None
    reporting.note("matcher.weights", path.name)
    return network.eval()


def save_network(path: Path, weights: Mapping[str, Tensor], sizes: Mapping[str, int]) -> None:
    """Write weights of a network of `sizes`, whole or not at all; raises RunError when the disk is full."""
    save_weights(path, weights, {"sizes": json.dumps(dict(sizes))})


def _read(path: Path) -> tuple[dict[str, int], dict[str, Tensor]]:
    if not path.is_file():
        raise InputError(f"{path}: no such weights file; give a .safetensors file, 'shipped' or 'untrained'.")
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            sizes = json.loads((file.metadata() or {}).get("sizes", "{}"))
            if any(not 0 <= size <= MOST_WIDTH for size in sizes.values()):
                raise ValueError(f"it says that its sizes are {str(sizes)[:200]}")
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
        if not all(tensor.isfinite().all() for tensor in state.values()):
            raise ValueError("it holds values that are not finite")
        return sizes, state
    except Exception as error:
        raise InputError(f"{path}: not a usable safetensors file ({error}).") from None
