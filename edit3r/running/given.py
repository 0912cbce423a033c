"""What Python hands to a run, checked at the door: one sentence where it cannot be used.

Files are checked where they are read (`edit3r.kit`); what is behind both doors trusts the page of
conventions (`edit3r.contract.types`).
"""

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.types import Cameras, Views
from edit3r.kit.photos.camera_files import intrinsics_from_outside, pose_from_outside

MAX_FOCAL = 100.0
"""[image sides], a view of half a degree: a longer focal length is believed to be in pixels.
A sanity limit.
"""
EXPECTED_IMAGES = "float32 sRGB in [0, 1]"


def check_views(views: Views) -> None:
    """Raise InputError for images, intrinsics or poses that cannot be used, naming the first."""
    _check_pixels("Views.images", views.images, EXPECTED_IMAGES)
    _check_intrinsics("Views.intrinsics", views.intrinsics)
    if views.c2w is not None:
        _check_poses("Views.c2w", views.c2w)


def check_cameras(cameras: Cameras, views: Views) -> None:
    """Raise InputError unless these are the cameras of all the views."""
    expected, got = views.images.shape[:2], cameras.c2w.shape[:2]
    if expected != got:
        raise InputError(
            f"cameras: got those of {got[0]} scenes of {got[1]} views, expected one for each of "
            f"the photos, {expected[0]} scenes of {expected[1]}."
        )
    _check_intrinsics("Cameras.intrinsics", cameras.intrinsics)
    _check_poses("Cameras.c2w", cameras.c2w)


def checked_masks(masks: Tensor) -> Tensor:
    """The masks as float32; raises InputError for those that are not in [0, 1]."""
    if masks.dtype == torch.bool:
        return masks.float()
    _check_pixels("masks", masks, "float32 in [0, 1], or bool")
    return masks


def _check_pixels(name: str, values: Tensor, expected: str) -> None:
    """Type, number and range of what has a value a pixel."""
    if not values.is_floating_point():
        raise InputError(
            f"{name}: got {_short(values.dtype)}, expected {expected}; give values.float() / 255."
        )
    _check_numbers(name, values, expected)
    low, high = (float(value) for value in values.detach().aminmax())
    if low >= 0 and high <= 1:
        return
    way_out = "divide by 255" if high > 2 and low >= 0 else "clamp to [0, 1]"
    raise InputError(
        f"{name}: got values from {low:.4g} to {high:.4g}, expected {expected}; {way_out}."
    )


def _check_intrinsics(name: str, values: Tensor) -> None:
    expected = "normalised 3x3: fx, cx in image widths, fy, cy in heights"
    _check_numbers(name, values, f"float32, {expected}")
    longest = float(values.detach().diagonal(dim1=-2, dim2=-1).max())
    if longest > MAX_FOCAL:
        raise InputError(
            f"{name}: got a focal length of {longest:.4g} image sides, as in pixels; expected "
            f"{expected}."
        )
    _check_each(
        name, values, lambda matrix: intrinsics_from_outside(matrix, 1, 1), expected
    )


def _check_poses(name: str, values: Tensor) -> None:
    expected = "camera-to-world 4x4, a rotation and a position"
    _check_numbers(name, values, f"float32, {expected}")
    _check_each(name, values, lambda matrix: pose_from_outside(matrix, "c2w"), expected)


def _check_numbers(name: str, values: Tensor, expected: str) -> None:
    """Raise InputError unless there are values, in float32, all finite."""
    if values.dtype != torch.float32:
        raise InputError(
            f"{name}: got {_short(values.dtype)}, expected {expected}; give .to(torch.float32)."
        )
    if values.numel() == 0:
        raise InputError(
            f"{name}: got shape {list(values.shape)}, which holds nothing; expected at least one "
            "of each."
        )
    bad = int((~values.detach().isfinite()).sum())
    if bad:
        raise InputError(
            f"{name}: {bad} of {values.numel()} values are not finite (NaN or infinite); expected "
            f"{expected}."
        )


def _check_each(
    name: str, values: Tensor, read: Callable[[Any], Any], expected: str
) -> None:
    """Raise InputError, with the scene and the view, for the first matrix that `read` refuses."""
    for scene, matrices in enumerate(values.detach().cpu().tolist()):
        for view, matrix in enumerate(matrices):
            try:
                read(matrix)
            except ValueError as error:
                raise InputError(
                    f"{name}[{scene}, {view}]: {error}; expected {expected}."
                ) from None


def _short(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")
