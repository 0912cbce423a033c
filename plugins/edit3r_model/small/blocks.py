"""The convolutional pieces both networks are made of."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with group norm; starts as the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(8, width)
        self.first = nn.Conv2d(width, width, 3, padding=1)
        self.second = nn.Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)

    def forward(self, x: Float[Tensor, "batch channel height width"]) -> Float[Tensor, "batch channel height width"]:
        return x + self.second(F.silu(self.first(F.silu(self.norm(x)))))


class GlobalBlock(nn.Module):
    """Self-attention over all positions of a small grid, so that an object is seen as a whole."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm = nn.GroupNorm(8, width)
        self.qkv = nn.Conv2d(width, 3 * width, 1)
        self.out = nn.Conv2d(width, width, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Float[Tensor, "batch channel height width"]) -> Float[Tensor, "batch channel height width"]:
        batch, width, rows, columns = x.shape
        split = self.qkv(self.norm(x)).reshape(batch, 3, self.heads, width // self.heads, rows * columns)
        q, k, v = split.transpose(-1, -2).unbind(1)  # [batch, head, token, channel]
        mixed = F.scaled_dot_product_attention(q, k, v).transpose(-1, -2)
        return x + self.out(mixed.reshape(batch, width, rows, columns))


def zero_conv(inputs: int, outputs: int) -> nn.Conv2d:
    """1x1 convolution that starts at 0: what it adds is nothing until trained."""
    conv = nn.Conv2d(inputs, outputs, 1)
    nn.init.zeros_(conv.weight)
    nn.init.zeros_(conv.bias)
    return conv


def upsample_to(x: Tensor, like: Tensor) -> Tensor:
    """Bilinear resize to the grid of `like`."""
    return F.interpolate(x, like.shape[-2:], mode="bilinear", align_corners=False)


def convex_upsample(
    values: Float[Tensor, "batch channel height width"], logits: Float[Tensor, "batch 36 height width"]
) -> Float[Tensor, "batch channel height2 width2"]:
    """Twice the size; each fine pixel is a convex mix of 3x3 coarse neighbours (Teed and Deng 2020, section 3.3)."""
    batch, channels, rows, columns = values.shape
    weights = logits.reshape(batch, 1, 9, 4, rows, columns).softmax(2)
    neighbours = F.unfold(F.pad(values, (1, 1, 1, 1), mode="replicate"), 3)
    neighbours = neighbours.reshape(batch, channels, 9, 1, rows, columns)
    mixed = (weights * neighbours).sum(2)  # [batch, channel, 4, rows, columns]
    return F.pixel_shuffle(mixed.reshape(batch, channels * 4, rows, columns), 2)


def convex_upsample_start(conv: nn.Conv2d, first: int) -> None:
    """Bias the 36 outputs from `first` on towards the coarse pixel each fine pixel lies in."""
    with torch.no_grad():
        conv.bias[first + 16 : first + 20] = 3.0  # neighbour 4 (the centre) of all four fine pixels
