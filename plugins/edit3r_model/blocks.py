"""Transformer blocks of the encoder and of the two decoders: pre-norm, exact GELU, no dropout, no layer scale."""

from typing import ClassVar

import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor, nn

from edit3r_model.rotary import Rotation

NORM_EPS = 1e-6


def layer_norm(width: int) -> nn.LayerNorm:
    return nn.LayerNorm(width, eps=NORM_EPS)


class SelfAttention(nn.Module):
    """Multi-head self-attention with rotary positions; `qkv` features are ordered [q | k | v], each [head, channel]."""

    turned: ClassVar[dict[str, int]] = {"qkv": 2}  # layer: how many blocks of its features are queries or keys

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.adjacent = False  # whether pairs of channels that turn together stand side by side in queries and keys
        self.qkv = nn.Linear(width, 3 * width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Float[Tensor, "batch token width"], rotation: Rotation) -> Float[Tensor, "batch token width"]:
        query_key, value = self.qkv(x).unflatten(-1, (3, self.heads, -1)).split((2, 1), 2)
        turn = rotation.adjacent if self.adjacent else rotation
        query, key = turn(query_key.flatten(2, 3)).unflatten(2, (2, self.heads)).unbind(2)
        return self.proj(attend(query, key, value.squeeze(2)))


class CrossAttention(nn.Module):
    """Each view's tokens read the tokens of other views.

    Keys and values depend on the token read alone, so they are computed once per view and gathered, which is cheaper
    than projecting a concatenated memory for every reader and gives the same numbers.
    """

    turned: ClassVar[dict[str, int]] = {"query": 1, "key_value": 1}

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.adjacent = False
        self.query = nn.Linear(width, width)
        self.key_value = nn.Linear(width, 2 * width)
        self.proj = nn.Linear(width, width)

    def forward(
        self,
        x: Float[Tensor, "batch reader token width"],
        memory: Float[Tensor, "batch source token width"],
        reads: Int[Tensor, "reader read"],
        rotation: Rotation,
    ) -> Float[Tensor, "batch reader token width"]:
        """`reads[i]` lists, in view order, which entries of `memory` reader i sees."""
        batch, readers = x.shape[:2]
        turn = rotation.adjacent if self.adjacent else rotation
        query = turn(self.query(x).flatten(0, 1).unflatten(-1, (self.heads, -1)))
        key, value = self.key_value(memory).flatten(0, 1).unflatten(-1, (2, self.heads, -1)).unbind(2)
        key, value = (_gather(tokens, reads, batch) for tokens in (turn(key), value))
        return self.proj(attend(query, key, value)).unflatten(0, (batch, readers))


class Mlp(nn.Module):
    """Linear, exact (erf) GELU, Linear."""

    fusable: ClassVar[dict[str, str]] = {
        "fc1": "act"
    }  # layer: the activation that follows it, which an engine may fuse in

    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, hidden)
        self.act = nn.GELU()
        self.fc2 = nn.Linear(hidden, width)

    def forward(self, x: Float[Tensor, "*batch width"]) -> Float[Tensor, "*batch width"]:
        return self.fc2(self.act(self.fc1(x)))


class EncoderBlock(nn.Module):
    """Self-attention, then MLP, each with a residual."""

    def __init__(self, width: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.norm1 = layer_norm(width)
        self.attn = SelfAttention(width, heads)
        self.norm2 = layer_norm(width)
        self.mlp = Mlp(width, hidden)

    def forward(self, x: Float[Tensor, "batch token width"], rotation: Rotation) -> Float[Tensor, "batch token width"]:
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
        x: Float[Tensor, "batch reader token width"],
        memory: Float[Tensor, "batch source token width"],
        reads: Int[Tensor, "reader read"],
        rotation: Rotation,
    ) -> Float[Tensor, "batch reader token width"]:
        x = x + self.attn(self.norm1(x).flatten(0, 1), rotation).unflatten(0, x.shape[:2])
        x = x + self.cross_attn(self.norm2(x), self.norm_memory(memory), reads, rotation)
        return x + self.mlp(self.norm3(x))


def attend(
    query: Float[Tensor, "batch token head channel"],
    key: Float[Tensor, "batch source head channel"],
    value: Float[Tensor, "batch source head channel"],
) -> Float[Tensor, "batch token width"]:
    """softmax(q k^T / sqrt(channels)) v per head, through torch's fused kernel."""
    mixed = F.scaled_dot_product_attention(query.transpose(1, 2), key.transpose(1, 2), value.transpose(1, 2))
    return mixed.transpose(1, 2).flatten(2)


def _gather(
    tokens: Float[Tensor, "batch_source token head channel"], reads: Int[Tensor, "reader read"], batch: int
) -> Float[Tensor, "batch_reader read_token head channel"]:
    """What each reader sees: the tokens of its sources one after the other."""
    if reads.shape[0] == 1:  # one reader sees everything: no copy
        return tokens.unflatten(0, (batch, -1)).flatten(1, 2)
    return tokens.unflatten(0, (batch, -1))[:, reads].flatten(2, 3).flatten(0, 1)
