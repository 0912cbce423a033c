"""Decides, pixel by pixel, whether a view shows its own edited colour or the reference's edit carried over."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r_model.small.blocks import (
    GlobalBlock,
    ResidualBlock,
    convex_upsample,
    convex_upsample_start,
    upsample_to,
    zero_conv,
)
from edit3r_model.small.edit_transport import HEADS, CarriedEdit
from edit3r_model.small.local_colour import CHANNELS, change_of
from edit3r_model.small.source_encoder import STRIDE

CANDIDATES = 3
"""Own edited colour; the photo under the carried colour map; the reference's edited colour along the geometry."""


@dataclass(frozen=True)
class FusedEdit:
    """One view's answer on the network's grid."""

    maps: Float[Tensor, "batch 12 height width"]  # the carried edit, refined
    choice: Float[Tensor, "batch 3 height width"]  # convex weights of the candidates
    opacity_correction: Float[Tensor, "batch 1 height width"]  # added to the opacity's logit, <= 0


class EditFusion(nn.Module):
    """Small two-level network on the token grid; starts by leaning towards the view's own colours."""

    def __init__(self, width: int) -> None:
        super().__init__()
        inputs = width + 9 + 2 * CHANNELS + HEADS + 9 + 3 + 3 + 7
        self.enter = nn.Conv2d(inputs, width, 1)
        self.fine = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.down = nn.Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.coarse = nn.Sequential(ResidualBlock(2 * width), GlobalBlock(2 * width), ResidualBlock(2 * width))
        self.up = nn.Conv2d(2 * width, width, 1)
        self.out = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.heads = zero_conv(width, 36 + STRIDE**2 * (CANDIDATES + 1))
        convex_upsample_start(self.heads, first=0)
        with torch.no_grad():
            self.heads.bias[36 : 36 + STRIDE**2] = 2.0  # own colour first

    def forward(
        self,
        tokens: Float[Tensor, "batch channel height2 width2"],
        photos: Float[Tensor, "batch 3 height width"],
        edited: Float[Tensor, "batch 3 height width"],
        own_maps: Float[Tensor, "batch 12 height2 width2"],
        carried: CarriedEdit,
        pulled: Float[Tensor, "batch 7 height width"],
    ) -> FusedEdit:
        """`pulled` is the reference along the geometry: edited colour, change, and 1 where it is inside."""
        photo, own = (F.avg_pool2d(x, STRIDE) for x in (photos, edited))
        change = change_of(carried.maps, photo)
        geometric = F.avg_pool2d(pulled, STRIDE)
        x = torch.cat(
            (
                tokens,
                photo - 0.5,
                own - 0.5,
                own - photo,
                own_maps,
                carried.maps,
                carried.evidence,
                carried.colours - torch.cat((photo, own, torch.zeros_like(own)), 1),
                change,
                photo + change - own,
                geometric,
            ),
            1,
        )
        x = self.fine(self.enter(x))
        x = self.out(x + upsample_to(self.up(self.coarse(self.down(x))), x))
        heads = self.heads(x)
        logits, opacity = F.pixel_shuffle(heads[:, 36:], STRIDE).split((CANDIDATES, 1), 1)
        return FusedEdit(
            maps=convex_upsample(carried.maps, heads[:, :36]),
            choice=logits.softmax(1),
            opacity_correction=-F.softplus(opacity - 4),
        )
