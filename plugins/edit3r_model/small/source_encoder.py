"""Network over the unedited photos and their matched geometry: features for the edit, and repairs of the geometry."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.geometry.warping import Correspondences, partner_views, warp
from edit3r_model.small.blocks import GlobalBlock, ResidualBlock, upsample_to, zero_conv

STRIDE = 2
"""Network pixels per token side."""


@dataclass(frozen=True)
class SourceFeatures:
    """The encoder's answer for B scenes of V views."""

    tokens: Float[Tensor, "batch view channel height2 width2"]  # at STRIDE
    depth_correction: Float[Tensor, "batch view height width"]  # added to log depth, in (-0.7, 0.7)
    opacity_correction: Float[Tensor, "batch view height width"]  # added to the opacity's logit
    scale_correction: Float[Tensor, "batch view height width"]  # added to the log scale, in (-0.5, 0.5)


class SourceEncoder(nn.Module):
    """U-Net with global attention at an eighth of the network's resolution; its corrections start at 0."""

    INPUTS = 12

    def __init__(self, width: int) -> None:
        super().__init__()
        self.stem = nn.Conv2d(self.INPUTS * STRIDE**2, width, 3, padding=1)
        self.blocks2 = nn.Sequential(ResidualBlock(width))
        self.down4 = nn.Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.blocks4 = nn.Sequential(ResidualBlock(2 * width), ResidualBlock(2 * width))
        self.down8 = nn.Conv2d(2 * width, 3 * width, 4, stride=2, padding=1)
        self.blocks8 = nn.Sequential(
            ResidualBlock(3 * width), GlobalBlock(3 * width), ResidualBlock(3 * width), GlobalBlock(3 * width)
        )
        self.up4 = nn.Conv2d(3 * width, 2 * width, 1)
        self.out4 = nn.Sequential(ResidualBlock(2 * width))
        self.up2 = nn.Conv2d(2 * width, width, 1)
        self.out2 = nn.Sequential(ResidualBlock(width))
        self.corrections = zero_conv(width, 3 * STRIDE**2)

    def forward(
        self,
        photos: Float[Tensor, "batch view 3 height width"],
        depths: Float[Tensor, "batch view height width"],
        confidence: Float[Tensor, "batch view height width"],
        matches: Correspondences,
    ) -> SourceFeatures:
        """Photos in [0, 1]; depths with median about 1; height and width multiples of 8."""
        x = F.pixel_unshuffle(self._inputs(photos, depths, confidence, matches).flatten(0, 1), STRIDE)
        x2 = self.blocks2(self.stem(x))
        x4 = self.blocks4(self.down4(x2))
        x8 = self.blocks8(self.down8(x4))
        x4 = self.out4(x4 + upsample_to(self.up4(x8), x4))
        x2 = self.out2(x2 + upsample_to(self.up2(x4), x2))
        depth, opacity, scale = F.pixel_shuffle(self.corrections(x2), STRIDE).unflatten(0, photos.shape[:2]).unbind(2)
        return SourceFeatures(
            x2.unflatten(0, photos.shape[:2]), 0.7 * torch.tanh(depth), opacity, 0.5 * torch.tanh(scale)
        )

    def _inputs(self, photos: Tensor, depths: Tensor, confidence: Tensor, matches: Correspondences) -> Tensor:
        """`[batch, view, 12, height, width]`: own and pulled colours, log depth and how far the views agree."""
        index = partner_views(photos.shape[1])
        pulled = warp(torch.cat((photos, confidence[:, :, None]), 2)[:, index], matches.coordinates)
        pulled = pulled * matches.inside[:, :, None]
        gap = (photos - pulled[:, :, :3]).abs().mean(2, keepdim=True) * matches.inside[:, :, None]
        single = (torch.log(depths), confidence, matches.inside, matches.depth_ratio)
        maps = torch.stack(single, 2)
        return torch.cat((photos - 0.5, pulled[:, :, :3], pulled[:, :, 3:], gap, maps), 2)
