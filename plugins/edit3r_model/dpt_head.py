"""Head `dpt-gaussian`: token levels to dense maps of centres and attributes, one Gaussian per
pixel.

Dense prediction transformer heads (DPT, Ranftl et al. 2021) as in MASt3R; two per role (view 0; all
others).
"""

from collections.abc import Callable
from functools import partial
from itertools import product

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

import edit3r
from edit3r.contract.errors import SettingsError
from edit3r.contract.interfaces import Backbone, GaussianHead, Geometry
from edit3r.contract.settings import Count
from edit3r.contract.types import Features, Gaussians, Views
from edit3r_model.asymmetric_vit import ROLES
from edit3r_model.gaussian_adapter import adapt, attribute_channels
from edit3r_model.memory import construct

IN_STRIPS = {3: (0, 1), 7: (0, 3)}
"""Padding (rows, columns) by kernel size of layers that see strips: these bring their bordering
rows along.
"""


Maps = Float[Tensor, "batch channel height width"]
PerView = Float[Tensor, "batch view channel height width"]
Rows = Callable[[int, int], Float[Tensor, "batch channel row width"]]
"""Computes the rows from a first to a last (exclusive) of a map."""


class DptGaussianHead(GaussianHead):
    """Two dense predictors per role: one for the Gaussians' centres, one for all their other
    attributes.

    Centres come from the transformer's features alone; attributes also see the image itself through
    a convolution that skips the transformer, which is what keeps colours sharp.
    """

    class Settings(edit3r.Settings):
        feature_width: Count = 256
        """channels of the fused maps"""
        point_width: Count = 128
        """channels of the centre predictor's last layers"""
        layer_widths: tuple[int, int, int, int] = (96, 192, 384, 768)
        """channels of the four reassembled levels, finest first"""
        harmonics_degree: int = Field(4, ge=0, le=4)
        """degree of the harmonics the network predicts"""
        keep_degree: int | None = Field(None, ge=0, le=4)
        """degree of the harmonics handed on; default: all predicted. The rasterizer the published
        models were trained with evaluates only up to 3, so 3 shows exactly what it showed
        """
        scale_factor: float = Field(0.001, gt=0)
        """of softplus(raw scale) [scene units]"""
        dropout: float = Field(0.0, ge=0, lt=1)
        """share of the attribute predictor's features left out while training"""
        levels: tuple[int, int, int, int] | None = None
        """which of the backbone's levels it reads, counted from 0, finest use first; default: four
        evenly spread from the first to the last
        """
        strip_rows: Count = 16
        """image rows computed at a time in the last layers; fewer need less memory, results are
        equal
        """
        seed: int | None = 0
        """of the initial weights; none leaves them empty (no memory), to be filled from a
        checkpoint
        """

    settings: Settings

    def __init__(self, settings: Settings, backbone: Backbone) -> None:
        super().__init__()
        self.settings = settings
        self.patch_size = backbone.patch_size
        self.levels = _levels(settings.levels, len(backbone.feature_widths))
        self.token_widths = tuple(backbone.feature_widths[i] for i in self.levels)
        kept, predicted = settings.keep_degree, settings.harmonics_degree
        self.degree = predicted if kept is None else min(kept, predicted)
        construct(self, self._build, settings.seed)

    def _build(self) -> None:
        sizes = self.token_widths, self.patch_size, self.settings
        self.centres = nn.ModuleList(CentrePredictor(*sizes) for _ in range(ROLES))
        attributes = (AttributePredictor(*sizes) for _ in range(ROLES))
        self.attributes = nn.ModuleList(attributes)

    def forward(
        self,
        features: Features,
        images: Float[Tensor, "batch view 3 height width"],
        source: Views,
        geometry: Geometry | None = None,
    ) -> Gaussians:
        """Gaussians of `images` alone."""
        return adapt(
            self.raw_points(features),
            self.raw_parameters(features, images),
            self.settings.scale_factor,
            self.degree,
        )

    def raw_points(self, features: Features) -> PerView:
        """Return the centre maps (three channels) before the exponential."""
        return self._per_view(self.centres, features, None)

    def raw_parameters(
        self, features: Features, images: Float[Tensor, "batch view 3 height width"]
    ) -> PerView:
        """Return the attribute maps before any activation.

        Channels: opacity 1, scales 3, quaternion xyzw 4, harmonics colour-major.
        """
        return self._per_view(self.attributes, features, images * 2 - 1)

    def _per_view(
        self, predictors: nn.ModuleList, features: Features, pixels: PerView | None
    ) -> PerView:
        """Run the right predictor on one view at a time: maps are large, one set is held."""
        levels = [features.levels[index] for index in self.levels]
        batch, views = levels[0].shape[:2]
        # [batch, view, height, width, channel], as the Gaussians are ordered.
        maps: Tensor | None = None
        for scene, view in product(range(batch), range(views)):
            rows = [level[scene, view].T for level in levels]
            given = [row.unflatten(1, features.grid)[None] for row in rows]
            extra = () if pixels is None else (pixels[scene, view, None],)
            predictor = predictors[min(view, ROLES - 1)]
            result = predictor(given, *extra)[0].movedim(0, -1)
            if maps is None:
                maps = result.new_empty(batch, views, *result.shape)
            maps[scene, view] = result
        assert maps is not None  # there are views
        return maps.movedim(-1, 2)


class CentrePredictor(nn.Module):
    """Raw centres of one view's Gaussians: trunk, then three convolutions, between which the map
    gets the image's size.
    """

    def __init__(
        self,
        token_widths: tuple[int, ...],
        patch_size: int,
        settings: DptGaussianHead.Settings,
    ) -> None:
        super().__init__()
        self.patch_size = patch_size
        width, points = settings.feature_width, settings.point_width
        self.strip_rows = settings.strip_rows
        self.trunk = DptTrunk(token_widths, settings.layer_widths, width)
        self.conv1 = nn.Conv2d(width, points, 3, padding=1)
        self.conv2 = nn.Conv2d(points, points, 3, padding=IN_STRIPS[3])
        self.out = nn.Conv2d(points, 3, 1)

    def forward(self, maps: list[Maps]) -> Maps:
        coarse = self.conv1(self.trunk(maps))
        height, width = (side * self.patch_size for side in maps[0].shape[-2:])
        fine = partial(resized_rows, coarse, (height, width))

        def strip(start: int, stop: int) -> Tensor:
            rows = with_border(fine, start, stop, height, 1)
            return self.out(F.relu(self.conv2(rows)))

        return in_strips(height, self.strip_rows, strip)


class AttributePredictor(nn.Module):
    """Raw attributes of one view's Gaussians: trunk at the image's size plus features of the image,
    then two convolutions.
    """

    def __init__(
        self,
        token_widths: tuple[int, ...],
        patch_size: int,
        settings: DptGaussianHead.Settings,
    ) -> None:
        super().__init__()
        self.patch_size = patch_size
        width = settings.feature_width
        self.strip_rows = settings.strip_rows
        self.dropout = settings.dropout
        self.trunk = DptTrunk(token_widths, settings.layer_widths, width)
        self.shortcut = nn.Conv2d(3, width, 7, padding=IN_STRIPS[7])
        self.conv = nn.Conv2d(width, width, 3, padding=IN_STRIPS[3], bias=False)
        self.out = nn.Conv2d(width, attribute_channels(settings.harmonics_degree), 1)

    def forward(self, maps: list[Maps], pixels: Maps) -> Maps:
        coarse = self.trunk(maps)
        height, width = (side * self.patch_size for side in maps[0].shape[-2:])
        fine = partial(resized_rows, coarse, (height, width))
        pixels = pixels.to(coarse.dtype)

        def photo(start: int, stop: int) -> Tensor:
            return pixels[:, :, start:stop]

        def seen(start: int, stop: int) -> Tensor:
            near = with_border(photo, start, stop, height, 3)
            return fine(start, stop) + F.relu(self.shortcut(near))

        def strip(start: int, stop: int) -> Tensor:
            x = F.relu(self.conv(with_border(seen, start, stop, height, 1)))
            return self.out(F.dropout(x, self.dropout, self.training))

        return in_strips(height, self.strip_rows, strip)


class DptTrunk(nn.Module):
    """Reassemble token levels into maps of four resolutions and fuse them from coarse to fine.

    With a patch grid of n x m the maps are 4n x 4m, 2n x 2m, n x m and ceil(n/2) x ceil(m/2); the
    result is 8n x 8m, whatever the patches' size.
    """

    def __init__(
        self, token_widths: tuple[int, ...], layer_widths: tuple[int, ...], width: int
    ) -> None:
        super().__init__()
        self.reassemble = nn.ModuleList(
            _reassemble(index, *widths)
            for index, widths in enumerate(zip(token_widths, layer_widths))
        )
        self.project = nn.ModuleList(
            nn.Conv2d(layer, width, 3, padding=1, bias=False) for layer in layer_widths
        )
        self.fuse = nn.ModuleList(Fusion(width, skip=index < 3) for index in range(4))

    def forward(self, maps: list[Maps]) -> Maps:
        """`maps` are the token levels on the patch grid, finest use first."""
        rows, columns = maps[0].shape[-2:]
        # May differ from the backbone's.
        dtype = next(self.reassemble.parameters()).dtype
        layers = [
            project(reassemble(level.to(dtype)))
            for project, reassemble, level in zip(self.project, self.reassemble, maps)
        ]
        # Odd grids: 2 ceil(n/2) is one too many.
        path = self.fuse[3](layers[3])[..., :rows, :columns]
        for index in (2, 1, 0):
            path = self.fuse[index](path, layers[index])
        return path


class ResidualUnit(nn.Module):
    """Residual convolutions: x + conv(relu(conv(relu(x))))."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(width, width, 3, padding=1)
        self.conv2 = nn.Conv2d(width, width, 3, padding=1)

    def forward(self, x: Maps) -> Maps:
        return x + self.conv2(F.relu(self.conv1(F.relu(x))))


class Fusion(nn.Module):
    """Add a finer map (if the block has a skip), refine, and double the resolution.

    The published order is upsampling, then the 1x1 convolution. Interpolation weights sum to one,
    so the two commute exactly; the convolution goes first here and costs a quarter.
    """

    def __init__(self, width: int, skip: bool) -> None:
        super().__init__()
        self.skip = ResidualUnit(width) if skip else None
        self.refine = ResidualUnit(width)
        self.out = nn.Conv2d(width, width, 1)

    def forward(self, x: Maps, finer: Maps | None = None) -> Maps:
        if self.skip is not None:
            x = x + self.skip(finer)
        return double(self.out(self.refine(x)))


def double(x: Maps) -> Maps:
    """Upsample bilinearly by 2 and keep the corner pixels in place (`align_corners`)."""
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=True)


def resized_rows(x: Maps, size: tuple[int, int], start: int, stop: int) -> Maps:
    """Compute the rows `start` to `stop` (exclusive) of `x` at `size` without the others.

    Bilinear, corner pixels in place: `double(x)` for twice the size.
    """
    height = x.shape[2]
    step = (height - 1) / max(size[0] - 1, 1)
    at = torch.arange(start, stop, device=x.device) * step
    low = at.long().clamp(max=max(height - 2, 0))
    high = (low + 1).clamp(max=height - 1)
    share = (at - low).to(x.dtype)[:, None, None]
    # Indexing this way round keeps channels-last maps channels-last.
    nhwc = x.permute(0, 2, 3, 1)
    rows = torch.lerp(nhwc[:, low], nhwc[:, high], share).permute(0, 3, 1, 2)
    return F.interpolate(
        rows, (stop - start, size[1]), mode="bilinear", align_corners=True
    )


def in_strips(height: int, rows: int, compute: Rows) -> Maps:
    """Join `compute(start, stop)` over strips of at most `rows` rows.

    Large maps never exist as a whole, and a strip stays in the cache from one layer to the next.
    """
    starts = range(0, height, rows)
    strips = [compute(start, min(start + rows, height)) for start in starts]
    return strips[0] if len(strips) == 1 else torch.cat(strips, 2)


def with_border(rows: Rows, start: int, stop: int, height: int, border: int) -> Maps:
    """Return rows `start - border` to `stop + border` of a map with `height` rows, zero beyond its
    edges.

    A convolution without padding in the rows needs them to give exactly the rows `start` to `stop`.
    """
    first, last = max(start - border, 0), min(stop + border, height)
    above, below = first - (start - border), stop + border - last
    maps = rows(first, last)
    return F.pad(maps, (0, 0, above, below)) if above or below else maps


def _levels(chosen: tuple[int, ...] | None, given: int) -> tuple[int, ...]:
    """Indices of the four of `given` levels that the head reads."""
    if given < 4:
        raise SettingsError(
            f"head: dpt-gaussian reads four levels, the backbone gives {given}."
        )
    if chosen is None:
        return tuple(round(index * (given - 1) / 3) for index in range(4))
    if not all(0 <= index < given for index in chosen):
        raise SettingsError(
            f"head.levels: the backbone has levels 0 to {given - 1}, got {chosen}."
        )
    return chosen


def _reassemble(index: int, token_width: int, layer_width: int) -> nn.Module:
    """From tokens to a map at `index`'s resolution: x4, x2, x1 or x1/2 of the patch grid's."""
    layers = nn.Sequential(nn.Conv2d(token_width, layer_width, 1))
    if index < 2:
        scale = 4 >> index
        layers.append(nn.ConvTranspose2d(layer_width, layer_width, scale, scale))
    if index == 3:
        layers.append(nn.Conv2d(layer_width, layer_width, 3, 2, padding=1))
    return layers
