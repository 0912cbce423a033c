"""The two trained parts of head `edit-fusion`: one carries the reference's edit to a view, one
weighs it there.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.kit.compute.layers import bilinear
from edit3r.kit.geometry.cameras import pixel_grid
from edit3r_model.colour_function import CHANNELS, change_of
from edit3r_model.layers import Conv2d
from edit3r_model.matched_unet import (
    STRIDE,
    UPSAMPLING,
    GlobalBlock,
    ResidualBlock,
    convex_upsample,
    convex_upsample_start,
    zero_conv,
)

HEADS = 2
"""Attention heads of the transport."""
CANDIDATES = 3
"""Own edited colour; the source image under the carried colour map; the reference's edited colour,
warped.
"""


Tokens = Float[Tensor, "batch channel height width"]
Maps = Float[Tensor, "batch 12 height width"]
Colours = Float[Tensor, "batch 3 height width"]
Rows = Float[Tensor, "batch head token channel"]


@dataclass(frozen=True)
class CarriedEdit:
    """What the reference shows at the points that correspond to a view's tokens."""

    maps: Maps  # affine colour maps; exactly 0 where nothing was edited
    # share of attention that found a place, in [0, 1]
    evidence: Float[Tensor, "batch head height width"]
    # mean source, mean edited colour and mean change found there
    colours: Float[Tensor, "batch 9 height width"]


class EditTransport(nn.Module):
    """Attention from a view's tokens to the reference's, by appearance and by distance to the
    corresponding point.

    The logit of query q at place p and key k at place x is q k - reach |p - x|^2, written as one
    product of longer vectors. Every head has its own reach; a null key takes the attention of what
    the reference does not show. Values are not learned: they are the reference's colour maps, so
    that no edit stays no edit.
    """

    def __init__(self, width: int, head_width: int = 19) -> None:
        super().__init__()
        self.query = nn.Sequential(
            Conv2d(width, width, 1), nn.SiLU(), Conv2d(width, HEADS * head_width, 1)
        )
        self.reach = Conv2d(width, HEADS, 1)
        self.head_mix = Conv2d(width, HEADS, 1)
        self.null = nn.Parameter(torch.zeros(HEADS))
        self.temperature = nn.Parameter(torch.full((HEADS,), 1.5))
        nn.init.zeros_(self.reach.weight)
        assert self.reach.bias is not None  # as it is made
        with torch.no_grad():
            self.reach.bias.copy_(torch.tensor([0.5, -3.0]))

    def forward(
        self,
        tokens: Tokens,
        reference: Tokens,
        coordinates: Float[Tensor, "batch height width 2"],
        maps: Maps,
        colours: Float[Tensor, "batch 9 height width"],
    ) -> CarriedEdit:
        """Carry the reference's colour `maps` and `colours` to the tokens.

        `coordinates` are where the tokens' points lie in the reference; the reference's tokens may
        be coarser.
        """
        query = self._queries(tokens, coordinates, reference.shape[-2:])
        key = self._keys(reference)
        value = torch.cat((maps, colours, torch.ones_like(maps[:, :1])), 1)
        channels = value.shape[1]
        value = value.flatten(2).transpose(1, 2)
        # As wide as the keys; the null key's value is 0.
        value = F.pad(value, (0, key.shape[-1] - channels, 1, 0))
        value = value[:, None].expand(-1, HEADS, -1, -1)
        attended = F.scaled_dot_product_attention(query, key, value, scale=1.0)
        attended = attended[..., :channels].transpose(-1, -2)
        # [batch, head, channel, height, width]
        attended = attended.unflatten(-1, tokens.shape[-2:])
        mixed = (self.head_mix(tokens).softmax(1)[:, :, None] * attended).sum(1)
        return CarriedEdit(
            maps=mixed[:, :CHANNELS],
            evidence=attended[:, :, -1],
            colours=mixed[:, CHANNELS:-1],
        )

    def _queries(self, tokens: Tokens, coordinates: Tensor, grid: torch.Size) -> Rows:
        """Appearance, then what makes -reach |position - key|^2, then 1 for the null key."""
        alike = self._embed(tokens) * self.temperature.exp()[:, None, None]
        # [batch, head, query, 1] 1 / cells^2
        reach = F.softplus(self.reach(tokens)).flatten(2)[..., None]
        size = coordinates.new_tensor(grid[::-1])
        # [cells] from the centre
        position = (coordinates.flatten(1, 2) * size - size / 2)[:, None]
        square = position.square().sum(-1, keepdim=True)
        place = 2 * reach * position, -reach, -reach * square
        return torch.cat((alike, *place, torch.ones_like(reach)), -1)

    def _keys(self, reference: Tokens) -> Rows:
        """Appearance and position of every key; the null key comes first."""
        batch, _, rows, columns = reference.shape
        alike = self._embed(reference)
        size = reference.new_tensor([columns, rows])
        position = (pixel_grid((rows, columns), reference) - 0.5) * size
        position = position.reshape(-1, 2).expand(batch, HEADS, -1, -1)
        square = position.square().sum(-1, keepdim=True)
        place = position, square, torch.ones_like(square)
        keys = torch.cat((alike, *place, torch.zeros_like(square)), -1)
        null = torch.zeros_like(keys[:, :, :1])
        null[..., -1] = self.null[:, None]
        return torch.cat((null, keys), 2)

    def _embed(self, x: Tokens) -> Rows:
        """Appearance as vectors of unit length."""
        embedded = self.query(x).unflatten(1, (HEADS, -1)).flatten(3)
        return F.normalize(embedded.transpose(-1, -2), dim=-1)


@dataclass(frozen=True)
class FusedEdit:
    """What the fusion decides for one view, on the network's grid."""

    maps: Maps  # the carried edit, refined
    choice: Colours  # convex weights of the candidates


class EditFusion(nn.Module):
    """Two-level network on the token grid that chooses, pixel by pixel, between a view's own edit
    and the carried one.

    It starts by leaning towards the view's own colours.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        # As `forward` joins them: tokens, own colours, two colour maps, evidence, what was found,
        # the carried change, what it leaves, and what was warped.
        inputs = width + 9 + 2 * CHANNELS + HEADS + 9 + 3 + 3 + 7
        self.enter = Conv2d(inputs, width, 1)
        self.fine = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.down = Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.coarse = nn.Sequential(
            ResidualBlock(2 * width), GlobalBlock(2 * width), ResidualBlock(2 * width)
        )
        self.up = Conv2d(2 * width, width, 1)
        self.out = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.heads = zero_conv(width, UPSAMPLING + STRIDE**2 * CANDIDATES)
        convex_upsample_start(self.heads)
        assert self.heads.bias is not None  # as it is made
        with torch.no_grad():
            # Own colour first.
            self.heads.bias[UPSAMPLING : UPSAMPLING + STRIDE**2] = 2.0

    def forward(
        self,
        tokens: Tokens,
        source: Colours,
        edited: Colours,
        own_maps: Maps,
        carried: CarriedEdit,
        warped: Float[Tensor, "batch 7 height width"],
    ) -> FusedEdit:
        """Weigh the candidates; `warped`: the reference's edited colour, change, and 1 inside."""
        before, own = F.avg_pool2d(source, STRIDE), F.avg_pool2d(edited, STRIDE)
        change = change_of(carried.maps, before)
        inputs = (
            tokens,
            before - 0.5,
            own - 0.5,
            own - before,
            own_maps,
            carried.maps,
            carried.evidence,
            carried.colours - torch.cat((before, own, torch.zeros_like(own)), 1),
            change,
            before + change - own,
            F.avg_pool2d(warped, STRIDE),
        )
        x = self.fine(self.enter(torch.cat(inputs, 1)))
        coarse = self.up(self.coarse(self.down(x)))
        x = self.out(x + bilinear(coarse, x.shape[-2:]))
        heads = self.heads(x)
        choice = F.pixel_shuffle(heads[:, UPSAMPLING:], STRIDE).softmax(1)
        maps = convex_upsample(carried.maps, heads[:, :UPSAMPLING])
        return FusedEdit(maps, choice)
