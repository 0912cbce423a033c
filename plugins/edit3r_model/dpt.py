"""Dense prediction trunk (DPT): four levels of tokens to one feature map at half the picture's resolution."""

from collections.abc import Callable
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn


class DptTrunk(nn.Module):
    """Reassemble token levels into maps of four resolutions and fuse them from coarse to fine.

    With a patch grid of n x m the maps are 4n x 4m, 2n x 2m, n x m and ceil(n/2) x ceil(m/2); the result is 8n x 8m.
    """

    def __init__(self, token_widths: tuple[int, ...], layer_widths: tuple[int, ...], width: int) -> None:
        super().__init__()
        self.reassemble = nn.ModuleList(
            _reassemble(index, tokens, layer) for index, (tokens, layer) in enumerate(zip(token_widths, layer_widths))
        )
        self.project = nn.ModuleList(nn.Conv2d(layer, width, 3, padding=1, bias=False) for layer in layer_widths)
        self.fuse = nn.ModuleList(Fusion(width, skip=index < 3) for index in range(4))

    def forward(self, maps: list[Float[Tensor, "batch channel rows columns"]]) -> Float[Tensor, "batch width 8n 8m"]:
        """`maps` are the token levels on the patch grid, finest use first."""
        grid = maps[0].shape[-2:]
        layers = [self.project[i](self.reassemble[i](level)) for i, level in enumerate(maps)]
        path = self.fuse[3](layers[3])[..., : grid[0], : grid[1]]  # odd grids: 2 ceil(n/2) is one too many
        for index in (2, 1, 0):
            path = self.fuse[index](path, layers[index])
        return path


class ResidualUnit(nn.Module):
    """x + conv(relu(conv(relu(x))))."""

    fusable: ClassVar[dict[str, str]] = {
        "conv1": "act"
    }  # layer: the activation that follows it, which an engine may fuse in

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1)
        self.act = nn.ReLU()
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Float[Tensor, "batch width h w"]) -> Float[Tensor, "batch width h w"]:
        return x + self.conv2(self.act(self.conv1(F.relu(x))))


class Fusion(nn.Module):
    """Add a finer map (if the block has a skip), refine, and double the resolution.

    The published order is upsampling, then the 1x1 convolution. Interpolation weights sum to one, so the two commute
    exactly; the convolution goes first here and costs a quarter.
    """

    def __init__(self, width: int, skip: bool) -> None:
        super().__init__()
        self.skip = ResidualUnit(width) if skip else None
        self.refine = ResidualUnit(width)
        self.out = nn.Conv2d(width, width, 1)

    def forward(
        self, x: Float[Tensor, "batch width h w"], finer: Float[Tensor, "batch width h w"] | None = None
    ) -> Float[Tensor, "batch width 2h 2w"]:
        if self.skip is not None:
            x = x + self.skip(finer)
        return double(self.out(self.refine(x)))


def double(x: Float[Tensor, "batch channel h w"]) -> Float[Tensor, "batch channel 2h 2w"]:
    """Bilinear upsampling by 2 that keeps the corner pixels in place (`align_corners`)."""
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)


def double_rows(x: Float[Tensor, "batch channel h w"], start: int, stop: int) -> Float[Tensor, "batch channel row 2w"]:
    """Rows `start` to `stop` (exclusive) of `double(x)`, without computing the others."""
    height = x.shape[2]
    at = torch.arange(start, stop, device=x.device) * ((height - 1) / (2 * height - 1))
    low = at.long().clamp(max=max(height - 2, 0))
    high = (low + 1).clamp(max=height - 1)
    share = (at - low).to(x.dtype)[:, None, None]
    nhwc = x.permute(0, 2, 3, 1)  # indexing this way round keeps channels-last maps channels-last
    rows = torch.lerp(nhwc[:, low], nhwc[:, high], share).permute(0, 3, 1, 2)
    return F.interpolate(rows, size=(stop - start, 2 * x.shape[3]), mode="bilinear", align_corners=True)


def in_strips(
    height: int, rows: int, compute: Callable[[int, int], Float[Tensor, "batch channel row width"]]
) -> Float[Tensor, "batch channel height width"]:
    """Join `compute(start, stop)` over strips of at most `rows` rows.

    Large maps never exist as a whole, and a strip stays in the cache from one layer to the next.
    """
    strips = [compute(start, min(start + rows, height)) for start in range(0, height, rows)]
    return strips[0] if len(strips) == 1 else torch.cat(strips, 2)


def with_border(
    rows_of: Callable[[int, int], Float[Tensor, "batch channel row width"]],
    start: int,
    stop: int,
    height: int,
    border: int,
) -> Float[Tensor, "batch channel row+2border width"]:
    """Rows `start - border` to `stop + border` of a map with `height` rows, zero beyond its edges.

    What a convolution without padding in the rows needs to give exactly the rows `start` to `stop`.
    """
    first, last = max(start - border, 0), min(stop + border, height)
    rows = rows_of(first, last)
    above, below = first - (start - border), stop + border - last
    return F.pad(rows, (0, 0, above, below)) if above or below else rows


def _reassemble(index: int, token_width: int, layer_width: int) -> nn.Module:
    """Tokens on the patch grid to a map of `index`'s resolution: x4, x2, x1, x1/2."""
    project = nn.Conv2d(token_width, layer_width, 1)
    resize = {
        0: lambda: nn.ConvTranspose2d(layer_width, layer_width, 4, 4),
        1: lambda: nn.ConvTranspose2d(layer_width, layer_width, 2, 2),
        3: lambda: nn.Conv2d(layer_width, layer_width, 3, 2, padding=1),
    }
    return nn.Sequential(project, resize[index]()) if index in resize else nn.Sequential(project)
