"""The unit of length that a run with given poses works in.

Camera files come in millimetres, kilometres or anything else; what follows (near planes, step
sizes, prices) is made for scenes of ordinary size. So a run works in a unit in which the cameras
stand about 1 apart, and its result is in the given one. Each scene of a batch has a unit of its
own. The factor is a power of two: it changes no other bit.
"""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import relative_to_first, scale_poses
from edit3r.running.scene import Scene

SAME_POSE = 1e-3
"""Most by which poses that were taken over differ from those that were given [mean distances]."""
VIEWS = ("photos", "start", "edited", "left_out")
"""Fields of a scene with poses; the first two are there from the beginning."""
LARGEST = 2.0**100  # factor of a unit; positions have limits of their own


def to_own_unit(scene: Scene) -> tuple[Scene, Float[Tensor, "batch"]]:
    """The scene in its own unit, and by what its lengths were multiplied; 1 without poses."""
    factor = own_unit(scene.photos)
    before = scene.before
    if before is not None:
        stands = has_given_poses(before, scene.photos)
        before = in_unit(before, torch.where(stands, factor, 1.0))
    moved: dict[str, Any] = {
        name: _views_in_unit(getattr(scene, name), factor) for name in VIEWS[:2]
    }
    return replace(scene, **moved, before=before), factor


def to_given_unit(
    scene: Scene, factor: Float[Tensor, "batch"], refined: bool = False
) -> Scene:
    """The scene in the unit of its given poses, if it was made on them (`refined`: or from them).

    A reconstructor that looks for poses by itself has a unit of its own, which stays.
    """
    if bool((factor == 1).all()):
        return scene
    back = 1 / factor
    changes: dict[str, Any] = {}
    made = scene.reconstruction
    if made is not None:
        stands = has_given_poses(made, scene.photos) | refined
        of_made = torch.where(stands, back, 1.0)
        changes = {
            "reconstruction": in_unit(made, of_made),
            "gaussians": _gaussians_in_unit(scene.gaussians, of_made),
        }
        if scene.before is not None:
            changes["before"] = in_unit(scene.before, of_made)
        if scene.rendered is not None:
            depths = _times(scene.rendered.depths, of_made)
            changes["rendered"] = replace(scene.rendered, depths=depths)
    for name in VIEWS:
        if getattr(scene, name) is not None:
            changes[name] = _views_in_unit(getattr(scene, name), back)
    return replace(scene, **changes)


def own_unit(views: Views) -> Float[Tensor, "batch"]:
    """Of each scene, the power of two that brings the cameras' mean distance from the first nearest
    to 1; in float64, on the CPU.
    """
    if views.c2w is None:
        return torch.ones(len(views.images), dtype=torch.float64)
    distances = _mean_distances(relative_to_first(views.c2w.cpu().double()))
    known = (distances > 0) & distances.isfinite()
    nearest = torch.exp2(-distances.log2().round()).clamp(1 / LARGEST, LARGEST)
    return torch.where(known, nearest, 1.0)


def has_given_poses(made: Reconstruction, views: Views) -> Bool[Tensor, "batch"]:
    """Which scenes of a reconstruction stand on the views' own poses, in their unit."""
    if made.cameras is None or views.c2w is None:
        return torch.zeros(len(views.images), dtype=torch.bool)
    given = relative_to_first(views.c2w.cpu().double())
    found = made.cameras.c2w.cpu().double()
    if given.shape != found.shape:
        return torch.zeros(len(views.images), dtype=torch.bool)
    apart = (found - given).abs()
    distances = _mean_distances(given).clamp(min=1e-30)
    apart[..., :3, 3] /= distances[:, None, None]
    return (apart <= SAME_POSE).flatten(1).all(1)


def in_unit(made: Reconstruction, factor: Float[Tensor, "batch"]) -> Reconstruction:
    """The reconstruction with its lengths times `factor`."""
    cameras = made.cameras
    if cameras is not None:
        cameras = replace(cameras, c2w=_poses_in_unit(cameras.c2w, factor))
    gaussians = _gaussians_in_unit(made.gaussians, factor)
    return replace(made, gaussians=gaussians, cameras=cameras)


def _gaussians_in_unit(
    gaussians: Gaussians, factor: Float[Tensor, "batch"]
) -> Gaussians:
    return replace(
        gaussians,
        means=_times(gaussians.means, factor),
        scales=_times(gaussians.scales, factor),
    )


def _views_in_unit(views: Views, factor: Float[Tensor, "batch"]) -> Views:
    if views.c2w is None:
        return views
    return replace(views, c2w=_poses_in_unit(views.c2w, factor))


def _poses_in_unit(
    c2w: Float[Tensor, "batch view 4 4"], factor: Float[Tensor, "batch"]
) -> Float[Tensor, "batch view 4 4"]:
    return scale_poses(c2w, factor.to(c2w)[:, None])


def _times(lengths: Tensor, factor: Float[Tensor, "batch"]) -> Tensor:
    """Lengths of each scene times its factor."""
    return lengths * factor.to(lengths).view(-1, *[1] * (lengths.ndim - 1))


def _mean_distances(c2w: Float[Tensor, "batch view 4 4"]) -> Float[Tensor, "batch"]:
    """Of the other cameras from the first, which stands at the origin; 0 without others."""
    distances = c2w[:, 1:, :3, 3].norm(dim=-1)
    return distances.sum(1) / max(distances.shape[1], 1)
