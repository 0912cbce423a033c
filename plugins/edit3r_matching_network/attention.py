"""Attention within a view and across to its partner, on tokens that know their viewing ray."""

import math

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

FREQUENCIES = 6


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
    """Tokens' viewing rays (x/z, y/z) as sines and cosines: the same for any picture size and shape."""

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

    def forward(self, tokens: Tensor, context: Tensor) -> Tensor:
        query = self._split(self.query(self.norm(tokens)))
        key, value = self.key_value(self.norm(context)).chunk(2, -1)
        mixed = F.scaled_dot_product_attention(query, self._split(key), self._split(value))
        return self.out(mixed.transpose(1, 2).flatten(2).view_as(tokens))

    def _split(self, x: Tensor) -> Tensor:
        """`[batch, 2, token, channel]` to `[batch * 2, head, token, channel / head]`: quick kernels want four axes."""
        return x.flatten(0, 1).unflatten(-1, (self.heads, -1)).transpose(1, 2)
