"""The unit of length that a run with given poses works in.

Camera files come in millimetres, kilometres or anything else; what follows (near planes, step
sizes, prices) is made for scenes of ordinary size. So a run works in a unit in which the cameras
stand about 1 apart, and its result is in the given one. The factor is a power of two: it changes no
other bit.
"""

import math
from dataclasses import replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import relative_to_first, scale_poses
from edit3r.running.scene import Scene

SAME_POSE = 1e-3
"""Most by which poses that were taken over differ from those that were given [mean distances]."""
VIEWS = ("photos", "start", "edited", "left_out")
"""Fields of a scene with poses; the first two are there from the beginning."""
LARGEST = 2.0**100  # factor of a unit; positions have limits of their own


def to_own_unit(scene: Scene) -> tuple[Scene, float]:
    """The scene in its own unit, and by what its lengths were multiplied; 1 without poses."""
    factor = own_unit(scene.photos)
    if factor == 1:
        return scene, factor
    before = scene.before
    if before is not None and has_given_poses(before, scene.photos):
        before = in_unit(before, factor)
    moved: dict[str, Any] = {
        name: _views_in_unit(getattr(scene, name), factor) for name in VIEWS[:2]
    }
    return replace(scene, **moved, before=before), factor


def to_given_unit(scene: Scene, factor: float, refined: bool = False) -> Scene:
    """The scene in the unit of its given poses, if it was made on them (`refined`: or from them).

    A reconstructor that looks for poses by itself has a unit of its own, which stays.
    """
    if factor == 1:
        return scene
    back = 1 / factor
    changes: dict[str, Any] = {}
    made = scene.reconstruction
    if made is not None and (refined or has_given_poses(made, scene.photos)):
        changes = {
            "reconstruction": in_unit(made, back),
            "gaussians": _gaussians_in_unit(scene.gaussians, back),
        }
        if scene.before is not None:
            changes["before"] = in_unit(scene.before, back)
        if scene.rendered is not None:
            depths = scene.rendered.depths * back
            changes["rendered"] = replace(scene.rendered, depths=depths)
    for name in VIEWS:
        if getattr(scene, name) is not None:
            changes[name] = _views_in_unit(getattr(scene, name), back)
    return replace(scene, **changes)


def own_unit(views: Views) -> float:
    """The power of two that brings the cameras' mean distance from the first nearest to 1."""
    if views.c2w is None:
        return 1.0
    distance = _mean_distance(relative_to_first(views.c2w.double()))
    if not 0 < distance < math.inf:
        return 1.0
    factor = 2.0 ** -round(math.log2(distance))
    return min(max(factor, 1 / LARGEST), LARGEST)


def has_given_poses(made: Reconstruction, views: Views) -> bool:
    """Whether the reconstruction stands on the views' own poses, in their unit."""
    if made.cameras is None or views.c2w is None:
        return False
    given = relative_to_first(views.c2w.double())
    found = made.cameras.c2w.double()
    if given.shape != found.shape:
        return False
    apart = (found - given.to(found)).abs()
    apart[..., :3, 3] /= max(_mean_distance(given), 1e-30)
    return bool((apart <= SAME_POSE).all())


def in_unit(made: Reconstruction, factor: float) -> Reconstruction:
    """The reconstruction with its lengths times `factor`."""
    cameras = made.cameras
    if cameras is not None:
        cameras = replace(cameras, c2w=scale_poses(cameras.c2w, factor))
    gaussians = _gaussians_in_unit(made.gaussians, factor)
    return replace(made, gaussians=gaussians, cameras=cameras)


def _gaussians_in_unit(gaussians: Gaussians, factor: float) -> Gaussians:
    return replace(
        gaussians, means=gaussians.means * factor, scales=gaussians.scales * factor
    )


def _views_in_unit(views: Views, factor: float) -> Views:
    if views.c2w is None:
        return views
    return replace(views, c2w=scale_poses(views.c2w, factor))


def _mean_distance(c2w: Float[Tensor, "batch view 4 4"]) -> float:
    """Of the other cameras from the first, which stands at the origin."""
    distances = c2w[:, 1:, :3, 3].norm(dim=-1)
    return float(distances.mean()) if distances.numel() else 0.0
