"""The small network of `edit3r`: repairs matched geometry, carries the reference's edit to the views, fuses the edits.

source images, matched depth --> SourceEncoder --> tokens, corrections of depth, opacity, scale
                                              |
edited, source images --> local colour maps --> EditTransport (reference -> view) --> EditFusion --> choice of colours

Its weights are fp16 safetensors with a JSON card beside them.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from edit3r import reporting
from edit3r.geometry.cameras import pixel_grid
from edit3r.geometry.warping import Correspondences, find_correspondences, warp
from edit3r.layers import Conv2d
from edit3r.training.checkpoint import WEIGHTS, load_weights
from edit3r_model.edit_colour import CHANNELS, change_of, fit_colour_maps
from edit3r_model.small_encoder import (
    STRIDE,
    GlobalBlock,
    ResidualBlock,
    SourceEncoder,
    SourceFeatures,
    convex_upsample,
    convex_upsample_start,
    upsample_to,
    zero_conv,
)

SHIPPED = Path(__file__).parent / "weights" / "edit3r-small.safetensors"
KEY_STRIDE = 4
"""Network pixels per side of what the reference offers to attention."""
GRID = 8
"""The network's images have sides that are multiples of this [pixels]."""
HEADS = 2
"""Attention heads of the transport."""
CANDIDATES = 3
"""Own edited colour; the source image under the carried colour map; the reference's edited colour, warped."""


@dataclass(frozen=True)
class NetworkInputs:
    """B scenes of V views on the network's grid; view 0 is the reference."""

    source: Float[Tensor, "batch view 3 height width"]  # unedited images, in [0, 1]
    edited: Float[Tensor, "batch view 3 height width"]  # in [0, 1]
    depths: Float[Tensor, "batch view height width"]  # matched; median of view 0 about 1
    confidence: Float[Tensor, "batch view height width"]  # in [0, 1]
    c2w: Float[Tensor, "batch view 4 4"]  # same unit as depths
    intrinsics: Float[Tensor, "batch view 3 3"]  # normalised


@dataclass(frozen=True)
class NetworkOutputs:
    """Corrections and colour decisions per view on the network's grid."""

    depth_correction: Float[Tensor, "batch view height width"]  # added to log depth
    opacity_correction: Float[Tensor, "batch view height width"]  # added to the logit
    scale_correction: Float[Tensor, "batch view height width"]  # added to the log scale
    disagreement: Float[Tensor, "batch view height width"]  # added to the logit near an edit, <= 0; 0 for the reference
    maps: Float[Tensor, "batch view 12 height width"]  # carried affine colour maps; 0 for the reference
    choice: Float[Tensor, "batch view 3 height width"]  # convex weights of the colour candidates


class SmallNetwork(nn.Module):
    """Encoder, transport and fusion; about a million parameters at the default width."""

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.width = width
        self.encoder = SourceEncoder(width)
        self.transport = EditTransport(width)
        self.fusion = EditFusion(width)
        self.to(memory_format=torch.channels_last)  # a quarter quicker on a CPU

    def forward(self, inputs: NetworkInputs) -> NetworkOutputs:
        matches = find_correspondences(inputs.depths, inputs.intrinsics, inputs.c2w)
        features = self.encoder(inputs.source, inputs.depths, inputs.confidence, matches)
        depths = inputs.depths * features.depth_correction.detach().exp()
        matches = find_correspondences(depths, inputs.intrinsics, inputs.c2w)
        fused = [self._fuse(inputs, features, matches, view) for view in range(1, inputs.source.shape[1])]
        return _outputs(features, fused)

    def _fuse(
        self, inputs: NetworkInputs, features: SourceFeatures, matches: Correspondences, view: int
    ) -> "FusedEdit":
        """Carry the reference's edit to one view and weigh it against the view's own."""
        source, edited, coordinates = inputs.source, inputs.edited, matches.coordinates[:, view]
        colours = torch.cat((source[:, 0], edited[:, 0], edited[:, 0] - source[:, 0]), 1)
        carried = self.transport(
            features.tokens[:, view],
            F.avg_pool2d(features.tokens[:, 0], KEY_STRIDE // STRIDE),
            _token_coordinates(coordinates, STRIDE),
            fit_colour_maps(source[:, 0], edited[:, 0], KEY_STRIDE, sigma=0.7),
            F.avg_pool2d(colours, KEY_STRIDE),
        )
        inside = matches.inside[:, view, None]
        warped = warp(colours[:, None, 3:], coordinates[:, None])[:, 0] * inside
        return self.fusion(
            features.tokens[:, view],
            source[:, view],
            edited[:, view],
            fit_colour_maps(source[:, view], edited[:, view], STRIDE, sigma=1.0),
            carried,
            torch.cat((warped, inside), 1),
        )


def _outputs(features: SourceFeatures, fused: list["FusedEdit"]) -> NetworkOutputs:
    """Join the answers for the views; the reference keeps its own colours."""
    first = fused[0]
    own = torch.zeros_like(first.choice)
    own[:, 0] = 1
    maps = torch.stack([torch.zeros_like(first.maps), *(f.maps for f in fused)], 1)
    choice = torch.stack([own, *(f.choice for f in fused)], 1)
    less = torch.stack([torch.zeros_like(first.opacity_correction), *(f.opacity_correction for f in fused)], 1)
    corrections = features.depth_correction, features.opacity_correction, features.scale_correction
    return NetworkOutputs(*corrections, less[:, :, 0], maps, choice)


def _token_coordinates(
    coordinates: Float[Tensor, "batch height width 2"], stride: int
) -> Float[Tensor, "batch height2 width2 2"]:
    """Coordinates of the tokens: the mean over each `stride` x `stride` cell."""
    return F.avg_pool2d(coordinates.permute(0, 3, 1, 2), stride).permute(0, 2, 3, 1)


def network_grid(image_size: tuple[int, int], longest: int) -> tuple[int, int]:
    """Return (height, width) near the image's shape with the longer side `longest`, in multiples of GRID."""
    height, width = image_size
    scale = longest / max(height, width)
    return tuple(max(GRID * 2, GRID * round(side * scale / GRID)) for side in (height, width))


@dataclass(frozen=True)
class CarriedEdit:
    """What the reference shows at the points that correspond to a view's tokens."""

    maps: Float[Tensor, "batch 12 height width"]  # affine colour maps; exactly 0 where nothing was edited
    evidence: Float[Tensor, "batch head height width"]  # share of attention that found a place, in [0, 1]
    colours: Float[Tensor, "batch 9 height width"]  # mean source, mean edited colour and mean change found there


class EditTransport(nn.Module):
    """Attention from a view's tokens to the reference's, by appearance and by distance to the corresponding point.

    Every head has its own reach around that point; a null key takes the attention of what the reference does
    not show. Values are not learned: they are the reference's colour maps, so that no edit stays no edit.
    """

    def __init__(self, width: int, head_width: int = 19) -> None:
        super().__init__()
        self.query = nn.Sequential(Conv2d(width, width, 1), nn.SiLU(), Conv2d(width, HEADS * head_width, 1))
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

        `coordinates` are where the tokens' points lie in the reference; the reference's tokens may be coarser.
        """
        rows, columns = tokens.shape[-2:]
        query, key = self._queries(tokens, coordinates, reference.shape[-2:]), self._keys(reference)
        value = torch.cat((maps, colours, torch.ones_like(maps[:, :1])), 1).flatten(2).transpose(1, 2)
        value = F.pad(value, (0, key.shape[-1] - value.shape[-1], 1, 0))  # the null key's value is 0
        value = value[:, None].expand(-1, HEADS, -1, -1)
        found = F.scaled_dot_product_attention(query, key, value, scale=1.0)  # [batch, head, query, channel]
        found = found[..., : CHANNELS + 10].transpose(-1, -2).unflatten(-1, (rows, columns))
        mixed = (self.head_mix(tokens).softmax(1)[:, :, None] * found).sum(1)
        return CarriedEdit(mixed[:, :CHANNELS], found[:, :, -1], mixed[:, CHANNELS:-1])

    def _queries(
        self,
        tokens: Float[Tensor, "batch channel height width"],
        coordinates: Float[Tensor, "batch height width 2"],
        grid: tuple[int, int],
    ) -> Float[Tensor, "batch head query channel"]:
        """Appearance, then what makes the product with a key -reach |position - key|^2, then 1 for the null key."""
        alike = self._embed(tokens) * self.temperature.exp()[:, None, None]
        reach = F.softplus(self.reach(tokens)).flatten(2)[..., None]  # [batch, head, query, 1] 1 / cells^2
        size = coordinates.new_tensor(grid[::-1])
        position = (coordinates.flatten(1, 2) * size - size / 2)[:, None]  # [cells] from the centre
        square = position.square().sum(-1, keepdim=True)
        return torch.cat((alike, 2 * reach * position, -reach, -reach * square, torch.ones_like(reach)), -1)

    def _keys(
        self, reference: Float[Tensor, "batch channel height width"]
    ) -> Float[Tensor, "batch head 1+key channel"]:
        """Appearance and position of every key; the null key comes first."""
        batch, _, rows, columns = reference.shape
        alike = self._embed(reference)
        position = (pixel_grid((rows, columns), reference) - 0.5) * reference.new_tensor([columns, rows])
        position = position.reshape(-1, 2).expand(batch, HEADS, -1, -1)
        square = position.square().sum(-1, keepdim=True)
        keys = torch.cat((alike, position, square, torch.ones_like(square), torch.zeros_like(square)), -1)
        null = torch.zeros_like(keys[:, :, :1])
        null = torch.cat((null[..., :-1], self.null[None, :, None, None].expand(batch, -1, 1, 1)), -1)
        return torch.cat((null, keys), 2)

    def _embed(self, x: Float[Tensor, "batch channel height width"]) -> Float[Tensor, "batch head token embedding"]:
        """Appearance as vectors of unit length."""
        embedded = self.query(x)
        return F.normalize(embedded.unflatten(1, (HEADS, -1)).flatten(3).transpose(-1, -2), dim=-1)


@dataclass(frozen=True)
class FusedEdit:
    """What the fusion decides for one view, on the network's grid."""

    maps: Float[Tensor, "batch 12 height width"]  # the carried edit, refined
    choice: Float[Tensor, "batch 3 height width"]  # convex weights of the candidates
    opacity_correction: Float[Tensor, "batch 1 height width"]  # added to the opacity's logit, <= 0


class EditFusion(nn.Module):
    """Two-level network on the token grid that chooses, pixel by pixel, between a view's own edit and the carried one.

    It starts by leaning towards the view's own colours.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        inputs = width + 9 + 2 * CHANNELS + HEADS + 9 + 3 + 3 + 7
        self.enter = Conv2d(inputs, width, 1)
        self.fine = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.down = Conv2d(width, 2 * width, 4, stride=2, padding=1)
        self.coarse = nn.Sequential(ResidualBlock(2 * width), GlobalBlock(2 * width), ResidualBlock(2 * width))
        self.up = Conv2d(2 * width, width, 1)
        self.out = nn.Sequential(ResidualBlock(width), ResidualBlock(width))
        self.heads = zero_conv(width, 36 + STRIDE**2 * (CANDIDATES + 1))
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
        """Weigh the candidates; `warped` is the reference's edited colour, its change, and 1 where it is inside."""
        before, own = (F.avg_pool2d(x, STRIDE) for x in (source, edited))
        change = change_of(carried.maps, before)
        found = carried.colours - torch.cat((before, own, torch.zeros_like(own)), 1)
        x = [tokens, before - 0.5, own - 0.5, own - before, own_maps, carried.maps, carried.evidence, found]
        x += [change, before + change - own, F.avg_pool2d(warped, STRIDE)]
        x = self.fine(self.enter(torch.cat(x, 1)))
        x = self.out(x + upsample_to(self.up(self.coarse(self.down(x))), x))
        heads = self.heads(x)
        logits, opacity = F.pixel_shuffle(heads[:, 36:], STRIDE).split((CANDIDATES, 1), 1)
        return FusedEdit(convex_upsample(carried.maps, heads[:, :36]), logits.softmax(1), -F.softplus(opacity - 4))


def load_network(weights: str) -> SmallNetwork:
    """Return the network with the 'shipped' weights, those of a file, or 'untrained', which is announced."""
    if weights == "untrained":
        reporting.warn("edit3r: the network is untrained; repairs and fused edits are those of a random start.")
        return SmallNetwork().eval()
    path = SHIPPED if weights == "shipped" else Path(weights)
    path = path / WEIGHTS if path.is_dir() else path
    card = read_card(path)
    network = SmallNetwork(width=int(card.get("width", 32)))
    load_weights(network, path)
    reporting.note("edit3r.weights", path.name)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    licence = card.get("licence", "not stated")
    reporting.note("weights.edit3r", {"file": path.name, "sha256": digest, "licence": licence})
    return network.eval()


def read_card(path: Path) -> dict:
    """Read the JSON card beside a weight file (data, steps, licence); {} when there is none."""
    card = path.with_suffix(".json")
    return json.loads(card.read_text(encoding="utf-8")) if card.is_file() else {}
