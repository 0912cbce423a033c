"""What every rasterizer shares: the settings, which are the rendering convention, and what it
refuses.
"""

import math

import torch
from jaxtyping import Float, Shaped
from pydantic import Field, model_validator
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.settings import Settings, Share
from edit3r.contract.types import Cameras, Gaussians

BORDER = 0.3
"""Tangents in the projection's Jacobian are clamped this far beyond the image's border [half image
widths]. A sanity limit.
"""
MAX_COLOUR = 1e30
"""Colours are clamped to [0, MAX_COLOUR], so that no finite input makes an infinite image."""
NEAR = 0.01
"""Camera z below which Gaussians are culled, but in smaller scenes [scene units].
A sanity limit.
"""
SMALL = 32 * NEAR
"""A scene of smaller size has a nearer near plane [scene units]."""
FAR = 1e30
"""Camera z above which nothing is drawn: sums of depths stay finite in float32 [scene units]."""
LOOKED_AT = 4096  # Gaussians that tell the size of a scene, evenly spaced
GAUSSIAN_FIELDS = ("means", "scales", "quats", "opacities", "harmonics")
MIN_TOTAL_ALPHA = 1e-10
"""Expected depth divides by at least this alpha."""


class RasterizerSettings(Settings):
    """How Gaussians become pixels; as 3D Gaussian Splatting but for a `max_alpha` of 0.999."""

    near_plane: float | None = Field(None, ge=1e-30, le=1e10)
    """Gaussians with camera z below are culled [scene units]; default: 0.01, less in scenes smaller
    than 0.32.
    """
    far_plane: float = Field(FAR, ge=1e-6, le=FAR)
    """Gaussians with camera z above are culled [scene units]; default: 1e30, none."""
    background: tuple[Share, Share, Share] = (0.0, 0.0, 0.0)
    """sRGB colour behind everything, each in [0, 1]."""
    eps2d: float = Field(0.3, ge=1e-3, le=100)
    """Added to the variances in the picture [pixels^2]."""
    max_alpha: float = Field(0.999, ge=0.01, le=0.9999)
    """No Gaussian hides more of a pixel than this."""
    min_alpha: float = Field(1 / 255, ge=1e-5, le=0.5)
    """A Gaussian is skipped where its alpha is below."""
    min_transmittance: float = Field(1e-4, ge=1e-6, le=0.5)
    """A pixel ends before the Gaussian that takes its transmittance to or below."""

    @model_validator(mode="after")
    def _check_ranges(self) -> "RasterizerSettings":
        near = NEAR if self.near_plane is None else self.near_plane
        if self.far_plane <= near:
            raise ValueError(
                f"far_plane ({self.far_plane}) must be above near_plane ({near})"
            )
        return self

    def near_planes(self, gaussians: Gaussians) -> list[float]:
        """Each scene's near plane: `near_plane`, or what suits the scene's size: halved until it is
        a 32nd of it at most.

        Scenes of ordinary size all have the same, so that parts of one are drawn as the whole is.
        """
        scenes = range(gaussians.means.shape[0])
        if self.near_plane is not None:
            return [self.near_plane for _ in scenes]
        return [_near_plane(size_of(gaussians, scene)) for scene in scenes]


def _near_plane(size: float) -> float:
    if not 0 < size < SMALL:
        return NEAR
    return NEAR * 2.0 ** math.floor(math.log2(size / SMALL))


def size_of(gaussians: Gaussians, scene: int) -> float:
    """How far nine of ten centres of one scene lie from the middle one at most [scene units]; 0
    for none.

    Transparent Gaussians do not count: they may be what fills a batch up.
    """
    shown = gaussians.opacities[scene].detach().nonzero()[:, 0]
    if len(shown) == 0:
        return 0.0
    means = gaussians.means[scene].detach()[shown[:: max(1, len(shown) // LOOKED_AT)]]
    # The squares of distances of 1e-23 are 0 in float32.
    means = means.to("cpu", torch.float64)
    distances = (means - means.median(0).values).norm(dim=-1)
    return float(distances.kthvalue(math.ceil(0.9 * len(means))).values)


def check_scene(gaussians: Gaussians, cameras: Cameras) -> None:
    """Raise InputError unless all is finite, of one batch, and focal lengths are positive."""
    check_cameras(gaussians, cameras)
    check_finite(gaussians)


def check_cameras(gaussians: Gaussians, cameras: Cameras) -> None:
    """Do the part of `check_scene` that reads no Gaussian, only a few numbers per camera."""
    dtype = gaussians.means.dtype
    if dtype not in (torch.float32, torch.float64):
        name = str(dtype).removeprefix("torch.")
        raise InputError(
            f"Gaussians: got {name}, in which depths and gradients overflow; rasterizers take "
            "float32 or float64: give gaussians.to(torch.float32)."
        )
    if cameras.c2w.shape[0] != gaussians.means.shape[0]:
        raise InputError(
            f"Cameras.c2w: got cameras for {cameras.c2w.shape[0]} scenes, but Gaussians of "
            f"{gaussians.means.shape[0]}; give each scene its cameras."
        )
    _check_finite("Cameras.c2w", cameras.c2w)
    _check_finite("Cameras.intrinsics", cameras.intrinsics)
    focal = torch.stack((cameras.intrinsics[..., 0, 0], cameras.intrinsics[..., 1, 1]))
    if bool((focal <= 0).any()):
        raise InputError(
            f"Cameras.intrinsics: focal lengths must be positive, got {focal.min().item():g}."
        )


def check_finite(gaussians: Gaussians) -> None:
    """Raise InputError that names the first field with values that are not finite."""
    for name in GAUSSIAN_FIELDS:
        _check_finite(f"Gaussians.{name}", getattr(gaussians, name))


def resolve_background(
    background: Tensor | None,
    default: tuple[float, float, float],
    gaussians: Gaussians,
    cameras: Cameras,
) -> Float[Tensor, "batch camera 3"]:
    """The background in the Gaussians' dtype: the given one, broadcast, or the setting."""
    means = gaussians.means
    value = means.new_tensor(default) if background is None else background.to(means)
    _check_finite("background", value)
    shape = (*cameras.c2w.shape[:2], 3)
    try:
        return value.expand(shape)
    except RuntimeError:
        raise InputError(
            f"background: expected a shape that fits {list(shape)}, got {list(value.shape)}."
        ) from None


def _check_finite(name: str, values: Shaped[Tensor, "*shape"]) -> None:
    wrong = values.numel() - int(torch.isfinite(values.detach()).sum())
    if wrong:
        verb = "is" if wrong == 1 else "are"
        raise InputError(
            f"{name}: {wrong} of {values.numel()} values {verb} not finite (NaN or infinite); "
            "give finite numbers."
        )
