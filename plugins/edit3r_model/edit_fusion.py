"""The two trained parts of head `edit-fusion`: one carries the reference's edit to a view, one
weighs it there.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.compute.layers import Conv2d
from edit3r.geometry.cameras import pixel_grid
from edit3r_model.edit_colour import CHANNELS, change_of
from edit3r_model.small_backbone import (
    STRIDE,
    GlobalBlock,
    ResidualBlock,
    convex_upsample,
    convex_upsample_start,
    upsample_to,
    zero_conv,
)

HEADS = 2
"""Attention heads of the transport."""
CANDIDATES = 3
"""Own edited colour; the source image under the carried colour map; the reference's edited colour,
warped.
"""


@dataclass(frozen=True)
class CarriedEdit:
    """What the reference shows at the points that correspond to a view's tokens."""

    maps: Float[
        Tensor, "batch 12 height width"
    ]  # affine colour maps; exactly 0 where nothing was edited
    evidence: Float[
        Tensor, "batch head height width"
    ]  # share of attention that found a place, in [0, 1]
    colours: Float[
        Tensor, "batch 9 height width"
    ]  # mean source, mean edited colour and mean change found there


class EditTransport(nn.Module):
    """Attention from a view's tokens to the reference's, by appearance and by distance to the
    corresponding point.

    Every head has its own reach around that point; a null key takes the attention of what the
    reference does not show. Values are not learned: they are the reference's colour maps, so that
    no edit stays no edit.
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
        with torch.no_grad():
            self.reach.bias.copy_(torch.tensor([0.5, -3.0]))

    def forward(
        self,
        tokens: Float[Tensor, "batch channel height width"],
        reference: Float[Tensor, "batch channel height2 width2"],
        coordinates: Float[Tensor, "batch height width 2"],
        maps: Float[Tensor, "batch 12 height2 width2"],
        colours: Float[Tensor, "batch 9 height2 width2"],
    ) -> CarriedEdit:
        """Carry the reference's colour `maps` and `colours` to the tokens.

        `coordinates` are where the tokens' points lie in the reference; the reference's tokens may
        be coarser.
        """
        rows, columns = tokens.shape[-2:]
        query, key = (
            self._queries(tokens, coordinates, reference.shape[-2:]),
            self._keys(reference),
        )
        value = (
            torch.cat((maps, colours, torch.ones_like(maps[:, :1])), 1)
            .flatten(2)
            .transpose(1, 2)
        )
        value = F.pad(
            value, (0, key.shape[-1] - value.shape[-1], 1, 0)
        )  # the null key's value is 0
        value = value[:, None].expand(-1, HEADS, -1, -1)
        found = F.scaled_dot_product_attention(
            query, key, value, scale=1.0
        )  # [batch, head, query, channel]
        found = (
            found[..., : CHANNELS + 10].transpose(-1, -2).unflatten(-1, (rows, columns))
        )
        mixed = (self.head_mix(tokens).softmax(1)[:, :, None] * found).sum(1)
        return CarriedEdit(mixed[:, :CHANNELS], found[:, :, -1], mixed[:, CHANNELS:-1])

    def _queries(
        self,
        tokens: Float[Tensor, "batch channel height width"],
        coordinates: Float[Tensor, "batch height width 2"],
        grid: tuple[int, int],
    ) -> Float[Tensor, "batch head query channel"]:
        """Appearance, then what makes the product with a key -reach |position - key|^2, then 1 for
        the null key.
        """
        alike = self._embed(tokens) * self.temperature.exp()[:, None, None]
        reach = F.softplus(self.reach(tokens)).flatten(2)[
            ..., None
        ]  # [batch, head, query, 1] 1 / cells^2
        size = coordinates.new_tensor(grid[::-1])
        position = (coordinates.flatten(1, 2) * size - size / 2)[
            :, None
        ]  # [cells] from the centre
        square = position.square().sum(-1, keepdim=True)
        return torch.cat(
            (
                alike,
                2 * reach * position,
                -reach,
                -reach * square,
                torch.ones_like(reach),
            ),
            -1,
        )

    def _keys(
        self, reference: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch head 1+key channel"]:
        """Appearance and position of every key; the null key comes first."""
        batch, _, rows, columns = reference.shape
        alike = self._embed(reference)
        position = (
            pixel_grid((rows, columns), reference) - 0.5
        ) * reference.new_tensor([columns, rows])
        position = position.reshape(-1, 2).expand(batch, HEADS, -1, -1)
        square = position.square().sum(-1, keepdim=True)
        keys = torch.cat(
            (
                alike,
                position,
                square,
                torch.ones_like(square),
                torch.zeros_like(square),
            ),
            -1,
        )
        null = torch.zeros_like(keys[:, :, :1])
        null = torch.cat(
            (null[..., :-1], self.null[None, :, None, None].expand(batch, -1, 1, 1)), -1
        )
        return torch.cat((null, keys), 2)

    def _embed(
        self, x: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch head token embedding"]:
        """Appearance as vectors of unit length."""
        embedded = self.query(x)
        return F.normalize(
            embedded.unflatten(1, (HEADS, -1)).flatten(3).transpose(-1, -2), dim=-1
        )


@dataclass(frozen=True)
class FusedEdit:
    """What the fusion decides for one view, on the network's grid."""

    maps: Float[Tensor, "batch 12 height width"]  # the carried edit, refined
    choice: Float[Tensor, "batch 3 height width"]  # convex weights of the candidates


class EditFusion(nn.Module):
    """Two-level network on the token grid that chooses, pixel by pixel, between a view's own edit
    and the carried one.

    It starts by leaning towards the view's own colours.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        inputs = width + 9 + 2 * CHANNELS + HEADS + 9 + 3 + 3 + 7
        self.enter = Conv2d(inputs, width, 1)
        self.fine = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.down = Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.coarse = nn.Sequential(
            ResidualBlock(2 * width), GlobalBlock(2 * width), ResidualBlock(2 * width)
        )
        self.up = Conv2d(2 * width, width, 1)
        self.out = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.heads = zero_conv(width, 36 + STRIDE**2 * CANDIDATES)
        convex_upsample_start(self.heads, first=0)
        with torch.no_grad():
            self.heads.bias[36 : 36 + STRIDE**2] = 2.0  # own colour first

    def forward(
        self,
        tokens: Float[Tensor, "batch channel height2 width2"],
        source: Float[Tensor, "batch 3 height width"],
        edited: Float[Tensor, "batch 3 height width"],
        own_maps: Float[Tensor, "batch 12 height2 width2"],
        carried: CarriedEdit,
        warped: Float[Tensor, "batch 7 height width"],
    ) -> FusedEdit:
        """Weigh the candidates; `warped` is the reference's edited colour, its change, and 1 where
        it is inside.
        """
        before, own = (F.avg_pool2d(x, STRIDE) for x in (source, edited))
        change = change_of(carried.maps, before)
        found = carried.colours - torch.cat((before, own, torch.zeros_like(own)), 1)
        x = [
            tokens,
            before - 0.5,
            own - 0.5,
            own - before,
            own_maps,
            carried.maps,
            carried.evidence,
            found,
        ]
        x += [change, before + change - own, F.avg_pool2d(warped, STRIDE)]
        x = self.fine(self.enter(torch.cat(x, 1)))
        x = self.out(x + upsample_to(self.up(self.coarse(self.down(x))), x))
        heads = self.heads(x)
        choice = F.pixel_shuffle(heads[:, 36:], STRIDE).softmax(1)
        return FusedEdit(convex_upsample(carried.maps, heads[:, :36]), choice)
