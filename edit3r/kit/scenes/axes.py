"""Scenes in other axes than ours (x right, y down, z forward), and what no scene may hold."""

from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.errors import InputError
from edit3r.contract.reporting import warn
from edit3r.contract.types import Gaussians
from edit3r.kit.geometry.harmonics import basis, rotate_harmonics
from edit3r.kit.geometry.rotations import matrices_to_quats, quats_to_matrices

UP_AND_BACK = (1.0, -1.0, -1.0)
"""Ours seen from y up and z backward, as glTF and SPZ have it, or the other way round."""

LEAST_OPACITY = 1 / 255  # below it a Gaussian is never drawn
LARGEST = 1e18  # a number whose square float32 holds; a larger one counts as infinite
SHORTEST_QUAT = 1e-6  # a shorter quaternion says nothing of a rotation


def flipped(gaussians: Gaussians, signs: tuple[float, float, float]) -> Gaussians:
    """The scene with the axes of which the sign is -1 turned round; twice is the scene itself."""
    x, y, z = signs
    means = gaussians.means
    flip = means.new_tensor(signs)
    # A mirrored rotation F R F is one as well.
    quats = gaussians.quats * means.new_tensor((1.0, y * z, x * z, x * y))
    anywhere = torch.nn.functional.normalize(means.new_tensor((0.2, 0.5, 0.8)), dim=0)
    degree = gaussians.degree
    change = basis(anywhere * flip, degree).sign() * basis(anywhere, degree).sign()
    return replace(
        gaussians,
        means=means * flip,
        quats=quats,
        harmonics=gaussians.harmonics * change[:, None],
    )


def rotated(gaussians: Gaussians, rotation: Float[Tensor, "3 3"]) -> Gaussians:
    """The scene turned about the origin."""
    rotation = rotation.to(gaussians.means)
    return replace(
        gaussians,
        means=gaussians.means @ rotation.T,
        quats=matrices_to_quats(rotation @ quats_to_matrices(gaussians.quats)),
        harmonics=rotate_harmonics(gaussians.harmonics, rotation),
    )


def drawable(gaussians: Gaussians) -> Bool[Tensor, "gaussian"]:
    """Which of a scene (batch 1) are finite and have a rotation."""
    values = (gaussians.means, gaussians.scales, gaussians.quats, gaussians.harmonics)
    finite = torch.isfinite(gaussians.opacities[0])
    for each in values:
        finite &= torch.isfinite(each[0]).flatten(1).all(1)
    return finite & (gaussians.quats[0].norm(dim=-1) > SHORTEST_QUAT)


def sound(path: Path, gaussians: Gaussians, *, visible: bool) -> Gaussians:
    """What of a scene from a file (batch 1) can be drawn: Gaussians that are not finite, or without
    a rotation, are left out with a warning, and negative sizes count as positive.

    Raises InputError with `visible` for a scene in which nothing can be drawn.
    """
    values = (gaussians.means, gaussians.scales, gaussians.quats, gaussians.harmonics)
    finite = torch.isfinite(gaussians.opacities[0])
    for each in values:
        finite &= (each[0].abs() < LARGEST).flatten(1).all(1)
    has_rotation = gaussians.quats[0].norm(dim=-1) > SHORTEST_QUAT
    lost = int((~finite).sum())
    if lost:
        warn(
            f"{path}: {lost} of {gaussians.count} Gaussians are not finite and left out."
        )
    lost = int((finite & ~has_rotation).sum())
    if lost:
        warn(
            f"{path}: {lost} of {gaussians.count} Gaussians have a quaternion of only zeros "
            "and are left out."
        )
    drawable = finite & has_rotation
    if not drawable.all():
        gaussians = gaussians.select(drawable)
    if (gaussians.scales < 0).any():
        warn(f"{path}: has negative sizes, which are taken as positive.")
        gaussians = replace(gaussians, scales=gaussians.scales.abs())
    if visible and gaussians.count and not gaussians.scales.any():
        raise InputError(f"{path}: shows nothing; all its Gaussians have the size 0.")
    if visible and not (gaussians.opacities >= LEAST_OPACITY).any():
        raise InputError(
            f"{path}: shows nothing; it has no Gaussian with an opacity of at least 1/255."
        )
    return gaussians
