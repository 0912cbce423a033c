"""Head `dpt-gaussian`: dense maps of centres and attributes, one Gaussian per pixel."""

from functools import partial
from typing import ClassVar

from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from edit3r.config import Settings
from edit3r.errors import SettingsError
from edit3r.interfaces import Backbone, GaussianHead
from edit3r.types import Features, Gaussians
from edit3r_model.dpt import DptTrunk, double_rows, in_strips, with_border
from edit3r_model.gaussians import assemble, attribute_channels
from edit3r_model.initialise import construct
from edit3r_model.roles import ROLES, assign_roles

IN_STRIPS = {3: (0, 1), 7: (0, 3)}
"""Padding (rows, columns) by kernel size of layers that see strips: these bring their bordering rows along."""


class DptGaussianHead(GaussianHead):
    """Two dense predictors per role (view 0; all others): centres, and everything else.

    Centres come from the transformer's features alone; attributes also see the picture itself through a convolution
    that skips the transformer, which is what keeps colours sharp.
    """

    class Settings(Settings):
        feature_width: int = Field(256, ge=1, description="channels of the fused maps")
        point_width: int = Field(128, ge=1, description="channels of the centre predictor's last layers")
        layer_widths: tuple[int, int, int, int] = Field(
            (96, 192, 384, 768), description="channels of the four reassembled levels, finest first"
        )
        harmonics_degree: int = Field(4, ge=0, le=4, description="degree of the harmonics the network predicts")
        keep_degree: int | None = Field(
            None,
            ge=0,
            le=4,
            description="degree of the harmonics handed on; default: all predicted. The rasterizer the published "
            "models were trained with evaluates only up to 3, so 3 shows exactly what it showed",
        )
        scale_factor: float = Field(0.001, gt=0, description="of softplus(raw scale) [scene units]")
        max_scale: float = Field(0.3, gt=0, description="largest standard deviation [scene units]")
        strip_rows: int = Field(
            16,
            ge=1,
            description="picture rows computed at a time in the last layers; fewer need less memory, results are equal",
        )
        seed: int | None = Field(
            0, description="of the initial weights; none leaves them empty (no memory), to be filled from a checkpoint"
        )

    def __init__(self, settings: Settings, backbone: Backbone) -> None:
        super().__init__()
        self.settings = settings
        self.token_widths, self.patch_size = tuple(backbone.feature_widths), backbone.patch_size
        if len(self.token_widths) != 4:
            raise SettingsError(f"head: dpt-gaussian reads 4 levels, the backbone gives {len(self.token_widths)}.")
        if self.patch_size != 16:
            raise SettingsError(f"head: dpt-gaussian needs patches of 16 pixels, the backbone has {self.patch_size}.")
        self.degree = min(settings.harmonics_degree, 4 if settings.keep_degree is None else settings.keep_degree)
        construct(self, self._build, settings.seed)

    def _build(self) -> None:
        self.centres = nn.ModuleList(CentrePredictor(self.token_widths, self.settings) for _ in range(ROLES))
        self.attributes = nn.ModuleList(AttributePredictor(self.token_widths, self.settings) for _ in range(ROLES))

    def initial_name(self, name: str) -> str:
        """Every leaf is drawn on its own."""
        return name

    def initial_leaf(self, name: str, leaf: nn.Module) -> None:
        """Torch's default."""

    def forward(self, features: Features, images: Float[Tensor, "batch view 3 height width"]) -> Gaussians:
        return assemble(
            self.raw_points(features),
            self.raw_parameters(features, images),
            self.settings.scale_factor,
            self.settings.max_scale,
            self.degree,
        )

    def raw_points(self, features: Features) -> Float[Tensor, "batch view 3 height width"]:
        """The centre maps before the exponential."""
        return self._per_view(self.centres, features, None)

    def raw_parameters(
        self, features: Features, images: Float[Tensor, "batch view 3 height width"]
    ) -> Float[Tensor, "batch view channel height width"]:
        """The attribute maps before any activation: opacity 1, scales 3, quaternion xyzw 4, harmonics colour-major."""
        return self._per_view(self.attributes, features, images * 2 - 1)

    def _per_view(self, predictors: nn.ModuleList, features: Features, pixels: Tensor | None) -> Tensor:
        """Run the right predictor on each picture, one at a time: maps are large, and only one set is in memory."""
        batch, views = features.levels[0].shape[:2]
        maps: Tensor | None = None  # [batch, view, height, width, channel], as the Gaussians are ordered
        for predictor, role in zip(predictors, assign_roles(views)):
            for view in range(views)[role.own]:
                for scene in range(batch):
                    levels = [_on_grid(level[scene, view], features.grid) for level in features.levels]
                    extra = () if pixels is None else (pixels[scene, view, None],)
                    result = predictor(levels, *extra)[0].movedim(0, -1)
                    maps = result.new_empty(batch, views, *result.shape) if maps is None else maps
                    maps[scene, view] = result
        return maps.movedim(-1, 2)


class CentrePredictor(nn.Module):
    """Trunk, then three convolutions with one doubling between them."""

    fusable: ClassVar[dict[str, str]] = {"conv2": "act"}

    def __init__(self, token_widths: tuple[int, ...], settings: DptGaussianHead.Settings) -> None:
        super().__init__()
        self.strip_rows = settings.strip_rows
        self.trunk = DptTrunk(token_widths, settings.layer_widths, settings.feature_width)
        self.conv1 = nn.Conv2d(settings.feature_width, settings.point_width, 3, padding=1)
        self.conv2 = nn.Conv2d(settings.point_width, settings.point_width, 3, padding=IN_STRIPS[3])
        self.act = nn.ReLU()
        self.out = nn.Conv2d(settings.point_width, 3, 1)

    def forward(self, maps: list[Tensor]) -> Float[Tensor, "batch 3 height width"]:
        half = self.conv1(self.trunk(maps))
        height = 2 * half.shape[2]

        def strip(start: int, stop: int) -> Tensor:
            rows = with_border(partial(double_rows, half), start, stop, height, 1)
            return self.out(self.act(self.conv2(rows)))

        return in_strips(height, self.strip_rows, strip)


class AttributePredictor(nn.Module):
    """Trunk, doubled, plus features of the picture itself, then two convolutions."""

    fusable: ClassVar[dict[str, str]] = {"shortcut": "shortcut_act", "conv": "act"}

    def __init__(self, token_widths: tuple[int, ...], settings: DptGaussianHead.Settings) -> None:
        super().__init__()
        width = settings.feature_width
        self.strip_rows = settings.strip_rows
        self.trunk = DptTrunk(token_widths, settings.layer_widths, width)
        self.shortcut = nn.Conv2d(3, width, 7, padding=IN_STRIPS[7])
        self.shortcut_act = nn.ReLU()
        self.conv = nn.Conv2d(width, width, 3, padding=IN_STRIPS[3], bias=False)
        self.act = nn.ReLU()
        self.out = nn.Conv2d(width, attribute_channels(settings.harmonics_degree), 1)

    def forward(
        self, maps: list[Tensor], pixels: Float[Tensor, "batch 3 height width"]
    ) -> Float[Tensor, "batch channel height width"]:
        half = self.trunk(maps)
        height = 2 * half.shape[2]
        pixels = pixels.to(half.dtype)

        def seen(start: int, stop: int) -> Tensor:
            near = with_border(lambda first, last: pixels[:, :, first:last], start, stop, height, 3)
            return double_rows(half, start, stop) + self.shortcut_act(self.shortcut(near))

        def strip(start: int, stop: int) -> Tensor:
            return self.out(self.act(self.conv(with_border(seen, start, stop, height, 1))))

        return in_strips(height, self.strip_rows, strip)


def _on_grid(tokens: Float[Tensor, "token channel"], grid: tuple[int, int]) -> Float[Tensor, "1 channel rows columns"]:
    return tokens.T.unflatten(1, grid)[None]
