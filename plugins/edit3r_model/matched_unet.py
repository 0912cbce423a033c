"""Backbone `matched-unet`: the unedited images and what matching says of them, seen together by a
small U-Net.

The convolutional blocks that the small form is made of are here as well.
"""

from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

import edit3r
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces import Backbone, Geometry
from edit3r.contract.settings import Index
from edit3r.contract.types import Features
from edit3r.kit.compute.layers import bilinear
from edit3r.kit.geometry.maps import resize
from edit3r.kit.geometry.warping import warp
from edit3r_model.edited_views import (
    Correspondences,
    find_correspondences,
    partner_views,
)
from edit3r_model.layers import Conv2d, GroupNorm

STRIDE = 2
"""Image pixels per side of a token."""
SMALLEST = 8
"""Least height and width of its images [pixels]: one cell of the coarsest level."""


UPSAMPLING = 36
"""Channels that `convex_upsample` is given: 3x3 neighbours of each of 2x2 fine pixels."""

Images = Float[Tensor, "batch view 3 height width"]
Maps = Float[Tensor, "batch channel height width"]


class MatchedUNet(Backbone):
    """U-Net with global attention at an eighth of the resolution; one level, at half of it."""

    patch_size = STRIDE
    uses_geometry = True

    class Settings(edit3r.Settings):
        width: int = Field(32, ge=8, le=512, multiple_of=8)
        """channels of its features"""
        seed: Index = 0
        """of the initial weights"""

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.settings = settings
        width = settings.width
        self.feature_widths = (width,)
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.stem = Conv2d(12 * STRIDE**2, width, 3, padding=1)
            self.blocks2 = nn.Sequential(ResidualBlock(width))
            self.down4 = Conv2d(width, 2 * width, 4, stride=2, padding=1)
            blocks = (ResidualBlock(2 * width) for _ in range(2))
            self.blocks4 = nn.Sequential(*blocks)
            self.down8 = Conv2d(2 * width, 3 * width, 4, stride=2, padding=1)
            self.blocks8 = nn.Sequential(
                ResidualBlock(3 * width),
                GlobalBlock(3 * width),
                ResidualBlock(3 * width),
                GlobalBlock(3 * width),
            )
            self.up4 = Conv2d(3 * width, 2 * width, 1)
            self.out4 = nn.Sequential(ResidualBlock(2 * width))
            self.up2 = Conv2d(2 * width, width, 1)
            self.out2 = nn.Sequential(ResidualBlock(width))

    def forward(
        self,
        images: Images,
        intrinsics: Float[Tensor, "batch view 3 3"],
        geometry: Geometry | None = None,
    ) -> Features:
        """Encode unedited images; the depths of `geometry` have a median of about 1."""
        height, width = images.shape[-2:]
        if geometry is None:
            raise InputError(
                "matched-unet needs geometry: pass what a matcher read from the images."
            )
        if min(height, width) < SMALLEST or height % STRIDE or width % STRIDE:
            raise InputError(
                f"matched-unet takes even sides of at least {SMALLEST} pixels, got "
                f"{height}x{width}."
            )
        matches = find_correspondences(geometry.depths, intrinsics, geometry.c2w)
        inputs = self._inputs(images, geometry, matches).flatten(0, 1)
        x2 = self.blocks2(self.stem(F.pixel_unshuffle(inputs, STRIDE)))
        x4 = self.blocks4(self.down4(x2))
        x8 = self.blocks8(self.down8(x4))
        x4 = self.out4(x4 + bilinear(self.up4(x8), x4.shape[-2:]))
        x2 = self.out2(x2 + bilinear(self.up2(x4), x2.shape[-2:]))
        tokens = x2.flatten(2).transpose(1, 2).unflatten(0, images.shape[:2])
        return Features((tokens,), tuple(x2.shape[-2:]))

    def _inputs(
        self, images: Images, geometry: Geometry, matches: Correspondences
    ) -> Float[Tensor, "batch view 12 height width"]:
        """Own and warped colours, log depth and how far the views agree."""
        partners, inside = partner_views(images.shape[1]), matches.inside[:, :, None]
        shown = torch.cat((images, geometry.confidence[:, :, None]), 2)
        warped = warp(shown[:, partners], matches.coordinates) * inside
        colours, confidence = warped.split((3, 1), 2)
        gap = (images - colours).abs().mean(2, keepdim=True) * inside
        own = torch.log(geometry.depths), geometry.confidence
        maps = torch.stack((*own, matches.inside, matches.depth_ratio), 2)
        return torch.cat((images - 0.5, colours, confidence, gap, maps), 2)


def averaged(geometry: Geometry, size: tuple[int, int]) -> Geometry:
    """`geometry` for images of a smaller (height, width); inverse depths are averaged."""
    return replace(
        geometry,
        depths=1 / resize(1 / geometry.depths[:, :, None], size)[:, :, 0],
        confidence=resize(geometry.confidence[:, :, None], size)[:, :, 0],
    )


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions with group norm; starts as the identity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.norm = GroupNorm(8, width)
        self.first = Conv2d(width, width, 3, padding=1)
        self.second = zero_conv(width, width, 3)

    def forward(self, x: Maps) -> Maps:
        return x + self.second(F.silu(self.first(F.silu(self.norm(x)))))


class GlobalBlock(nn.Module):
    """Self-attention over all positions of a small grid, so that an object is seen as a whole."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm = GroupNorm(8, width)
        self.qkv = Conv2d(width, 3 * width, 1)
        self.out = zero_conv(width, width)

    def forward(self, x: Maps) -> Maps:
        split = self.qkv(self.norm(x)).flatten(2).unflatten(1, (3, self.heads, -1))
        q, k, v = split.transpose(-1, -2).unbind(1)  # [batch, head, token, channel]
        mixed = F.scaled_dot_product_attention(q, k, v).transpose(-1, -2)
        return x + self.out(mixed.reshape(x.shape))


def zero_conv(inputs: int, outputs: int, side: int = 1) -> Conv2d:
    """Return a convolution that starts at 0: it adds nothing until it is trained."""
    conv = Conv2d(inputs, outputs, side, padding=side // 2)
    nn.init.zeros_(conv.weight)
    assert conv.bias is not None  # as it is made
    nn.init.zeros_(conv.bias)
    return conv


def convex_upsample(
    values: Maps, logits: Float[Tensor, "batch 36 height width"]
) -> Float[Tensor, "batch channel height2 width2"]:
    """Double the size; fine pixels are convex mixes of 3x3 coarse ones (Teed, Deng 2020, 3.3)."""
    batch, channels, rows, columns = values.shape
    weights = logits.reshape(batch, 1, 9, 4, rows, columns).softmax(2)
    neighbours = F.unfold(F.pad(values, (1, 1, 1, 1), mode="replicate"), 3)
    neighbours = neighbours.reshape(batch, channels, 9, 1, rows, columns)
    mixed = (weights * neighbours).sum(2)  # [batch, channel, 4, rows, columns]
    return F.pixel_shuffle(mixed.reshape(batch, channels * 4, rows, columns), 2)


def convex_upsample_start(conv: Conv2d) -> None:
    """Bias the first 36 outputs towards the coarse pixel each fine pixel lies in."""
    assert conv.bias is not None  # see zero_conv
    with torch.no_grad():
        conv.bias[16:20] = 3.0  # neighbour 4 (the centre) of all four fine pixels
