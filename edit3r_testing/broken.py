"""A reconstructor that is broken in a known way, as strongly as asked: for whoever judges scenes.

It makes a round Gaussian of each pixel from the run's geometry; `kind` says what is wrong with it.
Each kind shows its own photos well, since a photo's Gaussians stand before the others'.
"""

from collections.abc import Callable
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Geometry, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.rotations import quats_to_matrices

FOOTPRINT = 0.6  # standard deviation of a Gaussian of the sound one [pixels]
OPACITY = 0.95
TILES = 16  # along the longer side, of which some are missing

KINDS: dict[str, tuple[float, float, float]] = {
    "plane": (0.5, 0.75, 1.0),
    "noise": (0.1, 0.2, 0.35),
    "salt": (0.1, 0.25, 0.5),
    "steps": (6, 4, 2),
    "exchanged": (0.4, 0.7, 1.0),
    "stretched": (1.1, 1.2, 1.35),
    "turned": (1.5, 3, 6),
    "aside": (0.15, 0.3, 0.6),
    "torn": (0.1, 0.2, 0.333),
    "fat": (3, 6, 10),
}
"""Kinds with three strengths each; from the second on a picture from between shows it.

plane: inverse depths drawn to their median, this share of the way; noise: depths times a smooth
random factor, up to e to this power; salt: this share of the pixels at random depths; steps: only
so many depths; exchanged: what is near goes far, this share of the way; stretched: depths of all
but the first photo times this; turned: all but the first camera, and what it sees, by so many
degrees; aside: the same, moved by this share of the way between the photos; torn: this share of
the tiles is missing; fat: Gaussians so many times as wide.
"""


class BrokenReconstructor(Reconstructor):
    """One Gaussian a pixel from the run's geometry, broken as `kind` says; "": sound."""

    uses_geometry = True

    def __init__(self, kind: str = "", strength: float = 0.0) -> None:
        super().__init__(None)
        self.kind, self.strength = kind, strength

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        geometry: Geometry | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        assert geometry is not None
        views, geometry = geometry.calibrated(views), geometry.at(views.image_size)
        depths, c2w = geometry.depths, geometry.c2w
        kind, strength = self.kind, self.strength
        if kind in DEPTHS:
            depths = DEPTHS[kind](depths, strength)
        elif kind == "turned":
            c2w = _turned(c2w, strength)
        elif kind == "aside":
            c2w = _aside(c2w, strength)
        cameras = Cameras(c2w, views.intrinsics, views.image_size)
        wide = FOOTPRINT * (strength if kind == "fat" else 1)
        scales = pixel_scales(depths, views.intrinsics, wide)
        opacities = torch.full_like(depths, OPACITY)
        if kind == "torn":
            opacities = opacities * _tiles(depths, strength)
        made = pixels_to_gaussians(views.images, depths, cameras, scales, opacities)
        # a turned camera goes with what it sees: each photo shows itself
        return Reconstruction(made, cameras, geometry.registered, geometry.measured)


def without_views(made: Gaussians) -> Gaussians:
    """The same Gaussians, of which nobody knows whose they are."""
    return replace(made, view_index=torch.full_like(made.view_index, -1))


Depths = Float[Tensor, "batch view height width"]


def _plane(depths: Depths, share: float) -> Depths:
    inverse = 1 / depths
    middle = inverse.flatten(2).median(2).values[..., None, None]
    return 1 / torch.lerp(inverse, middle.expand_as(inverse), share)


def _noise(depths: Depths, power: float) -> Depths:
    return depths * (power * _smooth(depths)).exp()


def _salt(depths: Depths, share: float) -> Depths:
    chance = _random(depths.shape)
    low, high = _range(depths)
    anywhere = 1 / (1 / high + _random(depths.shape, 1) * (1 / low - 1 / high))
    return torch.where(chance < share, anywhere, depths)


def _steps(depths: Depths, count: float) -> Depths:
    low, high = _range(depths)
    share = (1 / depths - 1 / high) / (1 / low - 1 / high)
    level = ((share.clamp(0, 0.999) * count).floor() + 0.5) / count
    return 1 / (1 / high + level * (1 / low - 1 / high))


def _exchanged(depths: Depths, share: float) -> Depths:
    low, high = _range(depths)
    inverse = (1 / depths).clamp(1 / high, 1 / low)
    return 1 / torch.lerp(inverse, 1 / low + 1 / high - inverse, share)


def _stretched(depths: Depths, factor: float) -> Depths:
    return torch.cat((depths[:, :1], factor * depths[:, 1:]), 1)


DEPTHS: dict[str, Callable[[Depths, float], Depths]] = {
    "plane": _plane,
    "noise": _noise,
    "salt": _salt,
    "steps": _steps,
    "exchanged": _exchanged,
    "stretched": _stretched,
}


def _turned(c2w: Tensor, degrees: float) -> Tensor:
    half = torch.deg2rad(torch.tensor(degrees / 2))
    quat = torch.stack((half.cos(), torch.zeros(()), half.sin(), torch.zeros(())))
    turned = c2w.clone()
    turned[:, 1:, :3, :3] = c2w[:, 1:, :3, :3] @ quats_to_matrices(quat).to(c2w)
    return turned


def _aside(c2w: Tensor, share: float) -> Tensor:
    """Along each camera's y axis, across the way from photo to photo."""
    moved = c2w.clone()
    step = c2w[:, 1:, :3, 3].norm(dim=-1, keepdim=True)
    moved[:, 1:, :3, 3] += share * step * c2w[:, 1:, :3, 1]
    return moved


def _range(depths: Depths) -> tuple[Tensor, Tensor]:
    """Depths that are nearer and farther than nearly all others."""
    flat = depths.flatten(2)[..., ::7]
    low, high = (flat.quantile(share, 2)[..., None, None] for share in (0.05, 0.95))
    return low, torch.maximum(high, 1.01 * low)


def _random(shape: torch.Size, seed: int = 0) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(seed))


def _smooth(depths: Depths) -> Tensor:
    """Random numbers in [-1, 1] that change over an eighth of the picture."""
    coarse = 2 * _random((*depths.shape[:2], 9, 9)) - 1
    return F.interpolate(coarse, depths.shape[2:], mode="bicubic").clamp(-1, 1)


def _tiles(depths: Depths, share: float) -> Tensor:
    """0 in a share of the tiles, which are alike in no two photos; 1 elsewhere."""
    height, width = depths.shape[2:]
    rows = max(1, round(TILES * height / max(height, width)))
    columns = max(1, round(TILES * width / max(height, width)))
    kept = (_random((*depths.shape[:2], rows, columns)) >= share).to(depths)
    return F.interpolate(kept, (height, width), mode="nearest-exact")
