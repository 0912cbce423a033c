"""Features of one picture: fine ones at half its size, tokens at a quarter, on top of a front that is not trained."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r_matching_network.front import FRONT_CHANNELS, Front

FINE_STRIDE = 2
TOKEN_STRIDE = 4
GRID = 8
"""Pictures have sides that are multiples of this [pixels]."""


@dataclass(frozen=True)
class Pyramid:
    """Features of N pictures."""

    fine: Float[Tensor, "picture channel height2 width2"]  # stride FINE_STRIDE
    tokens: Float[Tensor, "picture channel2 height4 width4"]  # stride TOKEN_STRIDE, with what stride 8 sees


class PyramidEncoder(nn.Module):
    """Projects the front's features of strides 2, 4 and 8, and the pixels themselves, to two maps."""

    def __init__(self, width: int = 96, fine_width: int = 32) -> None:
        super().__init__()
        half, quarter, eighth = FRONT_CHANNELS
        self.front = Front()
        self.fine = _conv(half + 3 * FINE_STRIDE**2, fine_width)
        self.tokens = nn.Sequential(_conv(quarter + eighth, width), _conv(width, width), nn.Conv2d(width, width, 1))

    def forward(self, images: Float[Tensor, "picture 3 height width"]) -> Pyramid:
        images = standardised(images)
        half, quarter, eighth = self.front(images)
        pixels = F.pixel_unshuffle(images, FINE_STRIDE)
        eighth = F.interpolate(eighth, quarter.shape[-2:], mode="bilinear", align_corners=False)
        return Pyramid(self.fine(torch.cat((half, pixels), 1)), self.tokens(torch.cat((quarter, eighth), 1)))


def standardised(images: Float[Tensor, "picture 3 height width"]) -> Float[Tensor, "picture 3 height width"]:
    """Mean 0 and contrast about a half over each whole picture, whatever its exposure; a constant one becomes 0."""
    centred = images - images.mean((1, 2, 3), keepdim=True)
    return 0.5 * centred / (centred.square().mean((1, 2, 3), keepdim=True).sqrt() + 0.03)


def _conv(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, padding=1), nn.GroupNorm(8, outputs), nn.SiLU())
