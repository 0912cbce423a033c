"""The first part of the small network: features of the unedited images, repairs of their matched geometry.

The convolutional blocks that the whole small network is made of are here as well.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.geometry.warping import Correspondences, partner_views, warp
from edit3r.layers import Conv2d, GroupNorm, bilinear

STRIDE = 2
"""Network pixels per token side."""


@dataclass(frozen=True)
class SourceFeatures:
    """What the encoder finds in B scenes of V views."""

    tokens: Float[Tensor, "batch view channel height2 width2"]  # at STRIDE
    depth_correction: Float[Tensor, "batch view height width"]  # added to log depth, in (-0.7, 0.7)
    opacity_correction: Float[Tensor, "batch view height width"]  # added to the opacity's logit
    scale_correction: Float[Tensor, "batch view height width"]  # added to the log scale, in (-0.5, 0.5)


class SourceEncoder(nn.Module):
    """U-Net with global attention at an eighth of the network's resolution; its corrections start at 0."""

    INPUTS = 12

    def __init__(self, width: int) -> None:
        super().__init__()
        self.stem = Conv2d(self.INPUTS * STRIDE**2, width, 3, padding=1)
        self.blocks2 = nn.Sequential(ResidualBlock(width))
        self.down4 = Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.blocks4 = nn.Sequential(ResidualBlock(2 * width), ResidualBlock(2 * width))
        self.down8 = Conv2d(2 * width, 3 * width, 4, stride=2, padding=1)
        self.blocks8 = nn.Sequential(
            ResidualBlock(3 * width), GlobalBlock(3 * width), ResidualBlock(3 * width), GlobalBlock(3 * width)
        )
        self.up4 = Conv2d(3 * width, 2 * width, 1)
        self.out4 = nn.Sequential(ResidualBlock(2 * width))
        self.up2 = Conv2d(2 * width, width, 1)
        self.out2 = nn.Sequential(ResidualBlock(width))
        self.corrections = zero_conv(width, 3 * STRIDE**2)

    def forward(
        self,
        source: Float[Tensor, "batch view 3 height width"],
        depths: Float[Tensor, "batch view height width"],
        confidence: Float[Tensor, "batch view height width"],
        matches: Correspondences,
    ) -> SourceFeatures:
        """Encode `source`, the unedited images in [0, 1].

        `depths` have a median of about 1; height and width are multiples of 8.
        """
        x = F.pixel_unshuffle(self._inputs(source, depths, confidence, matches).flatten(0, 1), STRIDE)
        x2 = self.blocks2(self.stem(x))
        x4 = self.blocks4(self.down4(x2))
        x8 = self.blocks8(self.down8(x4))
        x4 = self.out4(x4 + upsample_to(self.up4(x8), x4))
        x2 = self.out2(x2 + upsample_to(self.up2(x4), x2))
        depth, opacity, scale = F.pixel_shuffle(self.corrections(x2), STRIDE).unflatten(0, source.shape[:2]).unbind(2)
        return SourceFeatures(
            x2.unflatten(0, source.shape[:2]), 0.7 * torch.tanh(depth), opacity, 0.5 * torch.tanh(scale)
        )

    def _inputs(
        self,
        source: Float[Tensor, "batch view 3 height width"],
        depths: Float[Tensor, "batch view height width"],
        confidence: Float[Tensor, "batch view height width"],
        matches: Correspondences,
    ) -> Float[Tensor, "batch view 12 height width"]:
        """Own and warped colours, log depth and how far the views agree."""
        index = partner_views(source.shape[1])
        warped = warp(torch.cat((source, confidence[:, :, None]), 2)[:, index], matches.coordinates)
        warped = warped * matches.inside[:, :, None]
        gap = (source - warped[:, :, :3]).abs().mean(2, keepdim=True) * matches.inside[:, :, None]
        single = (torch.log(depths), confidence, matches.inside, matches.depth_ratio)
        maps = torch.stack(single, 2)
        return torch.cat((source - 0.5, warped[:, :, :3], warped[:, :, 3:], gap, maps), 2)


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with group norm; starts as the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = GroupNorm(8, width)
        self.first = Conv2d(width, width, 3, padding=1)
        self.second = Conv2d(width, width, 3, padding=1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)

    def forward(self, x: Float[Tensor, "batch channel height width"]) -> Float[Tensor, "batch channel height width"]:
        return x + self.second(F.silu(self.first(F.silu(self.norm(x)))))


class GlobalBlock(nn.Module):
    """Self-attention over all positions of a small grid, so that an object is seen as a whole."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm = GroupNorm(8, width)
        self.qkv = Conv2d(width, 3 * width, 1)
        self.out = Conv2d(width, width, 1)
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Float[Tensor, "batch channel height width"]) -> Float[Tensor, "batch channel height width"]:
        batch, width, rows, columns = x.shape
        split = self.qkv(self.norm(x)).reshape(batch, 3, self.heads, width // self.heads, rows * columns)
        q, k, v = split.transpose(-1, -2).unbind(1)  # [batch, head, token, channel]
        mixed = F.scaled_dot_product_attention(q, k, v).transpose(-1, -2)
        return x + self.out(mixed.reshape(batch, width, rows, columns))


def zero_conv(inputs: int, outputs: int) -> nn.Conv2d:
    """Return a 1x1 convolution that starts at 0: it adds nothing until it is trained."""
    conv = Conv2d(inputs, outputs, 1)
    nn.init.zeros_(conv.weight)
    nn.init.zeros_(conv.bias)
    return conv


def upsample_to(
    x: Float[Tensor, "batch channel height width"], like: Float[Tensor, "batch other height2 width2"]
) -> Float[Tensor, "batch channel height2 width2"]:
    """Resize `x` bilinearly to the grid of `like`."""
    return bilinear(x, like.shape[-2:])


def convex_upsample(
    values: Float[Tensor, "batch channel height width"], logits: Float[Tensor, "batch 36 height width"]
) -> Float[Tensor, "batch channel height2 width2"]:
    """Double the size; each fine pixel is a convex mix of 3x3 coarse neighbours (Teed and Deng 2020, section 3.3)."""
    batch, channels, rows, columns = values.shape
    weights = logits.reshape(batch, 1, 9, 4, rows, columns).softmax(2)
    neighbours = F.unfold(F.pad(values, (1, 1, 1, 1), mode="replicate"), 3)
    neighbours = neighbours.reshape(batch, channels, 9, 1, rows, columns)
    mixed = (weights * neighbours).sum(2)  # [batch, channel, 4, rows, columns]
    return F.pixel_shuffle(mixed.reshape(batch, channels * 4, rows, columns), 2)


def convex_upsample_start(conv: Conv2d, first: int) -> None:
    """Bias the 36 outputs from `first` on towards the coarse pixel each fine pixel lies in."""
    with torch.no_grad():
        conv.bias[first + 16 : first + 20] = 3.0  # neighbour 4 (the centre) of all four fine pixels
