"""Transformer blocks of the encoder and of the two decoders, with rotary positions.

Pre-norm, exact GELU, no dropout, no layer scale. Linear layers start with Xavier-uniform weights
and zero bias. Positions are the two-dimensional rotary embedding of CroCo (Weinzaepfel et al.
2022): half of each head's channels are rotated by the token's row, half by its column. Inside a
half, channel j is paired with channel j + d/4 (not with its neighbour), and the pair is rotated by
the angle `position * BASE^(-4j/d)`, d being the width of a head.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

NORM_EPS = 1e-6
BASE = 100.0  # of the rotary frequencies, as in CroCo

Tokens = Float[Tensor, "batch token width"]
Heads = Float[Tensor, "batch token head channel"]
ByReader = Float[Tensor, "batch reader token width"]


@dataclass(frozen=True)
class Rotation:
    """Rotation angles of one sequence of tokens, as tables with one value per channel of a head."""

    cos: Float[Tensor, "token 1 channel"]
    sin: Float[Tensor, "token 1 channel"]  # negative for the first of each pair

    def __call__(self, x: Heads) -> Heads:
        """Rotate queries or keys; the dtype of `x` is kept."""
        partners = x.unflatten(-1, (2, 2, -1)).flip(-2).flatten(-3)
        return torch.addcmul(x * self.cos.to(x.dtype), partners, self.sin.to(x.dtype))


def patch_positions(grid: tuple[int, int]) -> Int[Tensor, "token 2"]:
    """(row, column) of every patch, row-major, then of the extra token in the row below."""
    rows, columns = grid
    positions = torch.cartesian_prod(torch.arange(rows), torch.arange(columns))
    return torch.cat((positions.reshape(-1, 2), torch.tensor([[rows, 0]])))


def make_rotation(
    positions: Int[Tensor, "token 2"],
    head_width: int,
    device: torch.device | str = "cpu",
) -> Rotation:
    """Build the tables for tokens at `positions`, computed in float64 and kept in float32."""
    pairs = head_width // 4
    frequencies = BASE ** (-torch.arange(pairs, dtype=torch.float64) / pairs)
    # [token, 1, axis, 1, pair]
    angles = positions.double()[:, None, :, None, None] * frequencies
    cos = angles.cos().expand(-1, -1, -1, 2, -1)
    sin = torch.cat((-angles.sin(), angles.sin()), -2)
    return Rotation(*(table.flatten(2).float().to(device) for table in (cos, sin)))


def _xavier_start(layer: nn.Linear | nn.Conv2d) -> None:
    """Make initial weights Xavier-uniform and the bias 0."""
    assert layer.bias is not None  # as it is made
    nn.init.xavier_uniform_(layer.weight.data.flatten(1))
    nn.init.zeros_(layer.bias)


class XavierLinear(nn.Linear):
    """Linear layer with a Xavier-uniform start."""

    def reset_parameters(self) -> None:
        super().reset_parameters()  # draws as many random numbers as torch's own start
        _xavier_start(self)


class XavierConv2d(nn.Conv2d):
    """Convolution with a Xavier-uniform start."""

    def reset_parameters(self) -> None:
        super().reset_parameters()  # draws as many random numbers as torch's own start
        _xavier_start(self)


def layer_norm(width: int) -> nn.LayerNorm:
    """Layer normalisation over `width` channels with the published epsilon."""
    return nn.LayerNorm(width, eps=NORM_EPS)


class SelfAttention(nn.Module):
    """Attention with rotary positions; `qkv` is ordered [q | k | v], each [head, channel]."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = XavierLinear(width, 3 * width)
        self.proj = XavierLinear(width, width)

    def forward(self, x: Tokens, rotation: Rotation) -> Tokens:
        qkv = self.qkv(x).unflatten(-1, (3, self.heads, -1))
        query_key, value = qkv.split((2, 1), 2)
        rotated = rotation(query_key.flatten(2, 3))
        query, key = rotated.unflatten(2, (2, self.heads)).unbind(2)
        return self.proj(attend(query, key, value.squeeze(2)))


class CrossAttention(nn.Module):
    """Multi-head attention from each view's tokens to the tokens of other views.

    Keys and values depend on the token read alone, so they are computed once per view and gathered,
    which is cheaper than projecting a concatenated memory for every reader and gives the same
    numbers.
    """

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = XavierLinear(width, width)
        self.key_value = XavierLinear(width, 2 * width)
        self.proj = XavierLinear(width, width)

    def forward(
        self,
        x: ByReader,
        memory: Float[Tensor, "batch source token width"],
        reads: Int[Tensor, "reader read"],
        rotation: Rotation,
    ) -> ByReader:
        """From `x` to `memory`, of which `reads[i]` lists, in view order, what reader i sees."""
        batch, readers = x.shape[:2]
        query = rotation(self.query(x).flatten(0, 1).unflatten(-1, (self.heads, -1)))
        read = self.key_value(memory).flatten(0, 1)
        key, value = read.unflatten(-1, (2, self.heads, -1)).unbind(2)
        key, value = _gather(rotation(key), reads, batch), _gather(value, reads, batch)
        return self.proj(attend(query, key, value)).unflatten(0, (batch, readers))


class Mlp(nn.Module):
    """Linear, exact (erf) GELU, Linear."""

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = XavierLinear(width, hidden)
        self.fc2 = XavierLinear(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(F.gelu(self.fc1(x)))


class EncoderBlock(nn.Module):
    """Self-attention, then MLP, each with a residual."""

    def __init__(self, width: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.norm1 = layer_norm(width)
        self.attn = SelfAttention(width, heads)
        self.norm2 = layer_norm(width)
        self.mlp = Mlp(width, hidden)

    def forward(self, x: Tokens, rotation: Rotation) -> Tokens:
        x = x + self.attn(self.norm1(x), rotation)
        return x + self.mlp(self.norm2(x))


class DecoderBlock(nn.Module):
    """Self-attention, cross-attention to the other views' tokens of the level before, then MLP."""

    def __init__(self, width: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.norm1 = layer_norm(width)
        self.attn = SelfAttention(width, heads)
        self.norm2 = layer_norm(width)
        self.norm_memory = layer_norm(width)
        self.cross_attn = CrossAttention(width, heads)
        self.norm3 = layer_norm(width)
        self.mlp = Mlp(width, hidden)

    def forward(
        self,
        x: ByReader,
        memory: Float[Tensor, "batch source token width"],
        reads: Int[Tensor, "reader read"],
        rotation: Rotation,
    ) -> ByReader:
        own = self.attn(self.norm1(x).flatten(0, 1), rotation)
        x = x + own.unflatten(0, x.shape[:2])
        memory = self.norm_memory(memory)
        x = x + self.cross_attn(self.norm2(x), memory, reads, rotation)
        return x + self.mlp(self.norm3(x))


def attend(
    query: Heads,
    key: Float[Tensor, "batch source head channel"],
    value: Float[Tensor, "batch source head channel"],
) -> Tokens:
    """Attention softmax(q k^T / sqrt(channels)) v per head, by torch's fused kernel."""
    query, key, value = (x.transpose(1, 2) for x in (query, key, value))
    mixed = F.scaled_dot_product_attention(query, key, value)
    return mixed.transpose(1, 2).flatten(2)


def _gather(
    tokens: Float[Tensor, "batch_source token head channel"],
    reads: Int[Tensor, "reader read"],
    batch: int,
) -> Float[Tensor, "batch_reader read_token head channel"]:
    """Join, for each reader, the tokens of all the views that it reads."""
    by_source = tokens.unflatten(0, (batch, -1))
    if reads.shape[0] == 1:  # one reader sees everything: no copy
        return by_source.flatten(1, 2)
    return by_source[:, reads].flatten(2, 3).flatten(0, 1)
