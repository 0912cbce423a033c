"""What a rasterizer refuses at the door, as sentences that name the field."""

import torch
from torch import Tensor

from edit3r.errors import InputError
from edit3r.types import Cameras, Gaussians

GAUSSIAN_FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


def check_scene(gaussians: Gaussians, cameras: Cameras) -> None:
    """Raise InputError unless Gaussians and cameras are finite, of one batch, and the focal lengths positive."""
    check_cameras(gaussians, cameras)
    check_finite(gaussians)


def check_cameras(gaussians: Gaussians, cameras: Cameras) -> None:
    """The part of `check_scene` that reads no Gaussian: a few numbers per camera."""
    if cameras.c2w.shape[0] != gaussians.means.shape[0]:
        raise InputError(
            f"Cameras.c2w: got cameras for {cameras.c2w.shape[0]} scenes, but Gaussians of "
            f"{gaussians.means.shape[0]}; give each scene its cameras."
        )
    _check_finite("Cameras.c2w", cameras.c2w)
    _check_finite("Cameras.intrinsics", cameras.intrinsics)
    focal = torch.stack((cameras.intrinsics[..., 0, 0], cameras.intrinsics[..., 1, 1]))
    if bool((focal <= 0).any()):
        raise InputError(f"Cameras.intrinsics: focal lengths must be positive, got {focal.min().item():g}.")


def check_finite(gaussians: Gaussians) -> None:
    """Raise InputError that names the first field with a value that is no number, and how many it has."""
    for name in GAUSSIAN_FIELDS:
        _check_finite(f"Gaussians.{name}", getattr(gaussians, name))


def resolve_background(
    background: Tensor | None, default: tuple[float, float, float], gaussians: Gaussians, cameras: Cameras
) -> Tensor:
    """The background as `[B, C, 3]` in the Gaussians' dtype: a tensor that broadcasts to it, or the setting."""
    means = gaussians.means
    value = means.new_tensor(default) if background is None else background.to(means)
    _check_finite("background", value)
    shape = (*cameras.c2w.shape[:2], 3)
    try:
        return value.expand(shape)
    except RuntimeError:
        raise InputError(f"background: expected a shape that fits {list(shape)}, got {list(value.shape)}.") from None


def _check_finite(name: str, values: Tensor) -> None:
    wrong = values.numel() - int(torch.isfinite(values.detach()).sum())
    if wrong:
        verb = "is" if wrong == 1 else "are"
        raise InputError(
            f"{name}: {wrong} of {values.numel()} values {verb} not finite (NaN or infinite); give finite numbers."
        )
