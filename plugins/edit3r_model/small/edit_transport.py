"""Attention that carries the reference view's edit to another view, guided but not bound by the matched geometry."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.geometry.cameras import pixel_grid
from edit3r_model.small.local_colour import CHANNELS

HEADS = 2


@dataclass(frozen=True)
class CarriedEdit:
    """What the reference shows at the places that correspond to a view's tokens."""

    maps: Float[Tensor, "batch 12 height width"]  # affine colour maps; exactly 0 where nothing was edited
    evidence: Float[Tensor, "batch head height width"]  # share of attention that found a place, in [0, 1]
    colours: Float[Tensor, "batch 9 height width"]  # mean photo, mean edited and mean change found there


class EditTransport(nn.Module):
    """Each token of a view attends to the reference's tokens by appearance and by distance to its matched place.

    Every head has its own reach around the matched place; a null key takes the attention of what the reference does
    not show. Values are not learned: they are the reference's colour maps, so that no edit stays no edit.
    """

    def __init__(self, width: int, head_width: int = 19) -> None:
        super().__init__()
        self.query = nn.Sequential(nn.Conv2d(width, width, 1), nn.SiLU(), nn.Conv2d(width, HEADS * head_width, 1))
        self.reach = nn.Conv2d(width, HEADS, 1)
        self.head_mix = nn.Conv2d(width, HEADS, 1)
        self.null = nn.Parameter(torch.zeros(HEADS))
        self.temperature = nn.Parameter(torch.full((HEADS,), 1.5))
        nn.init.zeros_(self.reach.weight)
        with torch.no_grad():
            self.reach.bias.copy_(torch.tensor([0.5, -3.0]))

    def forward(
        self,
        tokens: Float[Tensor, "batch channel height width"],
        reference: Float[Tensor, "batch channel height2 width2"],
        places: Float[Tensor, "batch height width 2"],
        maps: Float[Tensor, "batch 12 height2 width2"],
        colours: Float[Tensor, "batch 9 height2 width2"],
    ) -> CarriedEdit:
        """`places` are the tokens' matched places in the reference; the reference's tokens may be coarser."""
        rows, columns = tokens.shape[-2:]
        query, key = self._queries(tokens, places, reference.shape[-2:]), self._keys(reference)
        value = torch.cat((maps, colours, torch.ones_like(maps[:, :1])), 1).flatten(2).transpose(1, 2)
        value = F.pad(value, (0, key.shape[-1] - value.shape[-1], 1, 0))  # the null key's value is 0
        value = value[:, None].expand(-1, HEADS, -1, -1)
        found = F.scaled_dot_product_attention(query, key, value, scale=1.0)  # [batch, head, query, channel]
        found = found[..., : CHANNELS + 10].transpose(-1, -2).unflatten(-1, (rows, columns))
        mixed = (self.head_mix(tokens).softmax(1)[:, :, None] * found).sum(1)
        return CarriedEdit(mixed[:, :CHANNELS], found[:, :, -1], mixed[:, CHANNELS:-1])

    def _queries(self, tokens: Tensor, places: Tensor, grid: tuple[int, int]) -> Tensor:
        """Appearance, then what makes the product with a key -reach |place - key|^2, then 1 for the null key."""
        alike = self._embed(tokens) * self.temperature.exp()[:, None, None]
        reach = F.softplus(self.reach(tokens)).flatten(2)[..., None]  # [batch, head, query, 1] 1 / cells^2
        place = (places.flatten(1, 2) * places.new_tensor([grid[1], grid[0]]) - places.new_tensor(grid[::-1]) / 2)[
            :, None
        ]
        square = place.square().sum(-1, keepdim=True)
        return torch.cat((alike, 2 * reach * place, -reach, -reach * square, torch.ones_like(reach)), -1)

    def _keys(self, reference: Tensor) -> Tensor:
        """`[batch, head, 1 + key, channel]`; the null key comes first."""
        batch, _, rows, columns = reference.shape
        alike = self._embed(reference)
        place = (pixel_grid((rows, columns), reference) - 0.5) * reference.new_tensor([columns, rows])
        place = place.reshape(-1, 2).expand(batch, HEADS, -1, -1)
        square = place.square().sum(-1, keepdim=True)
        keys = torch.cat((alike, place, square, torch.ones_like(square), torch.zeros_like(square)), -1)
        null = torch.zeros_like(keys[:, :, :1])
        null = torch.cat((null[..., :-1], self.null[None, :, None, None].expand(batch, -1, 1, 1)), -1)
        return torch.cat((null, keys), 2)

    def _embed(self, x: Tensor) -> Tensor:
        """`[batch, head, token, channel]` of unit length."""
        embedded = self.query(x)
        return F.normalize(embedded.unflatten(1, (HEADS, -1)).flatten(3).transpose(-1, -2), dim=-1)
