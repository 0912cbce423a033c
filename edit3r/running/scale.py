"""The unit of length that a run with given poses works in.

Camera files come in millimetres, kilometres or anything else; what follows (near planes, step
sizes, prices) is made for scenes of ordinary size. So a run works in a unit in which the cameras
stand about 1 apart, and its result is in the given one. Each scene of a batch has a unit of its
own. The factor is a power of two: it changes no other bit.
"""

from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.kit.geometry.cameras import relative_to_first, scale_poses
from edit3r.running.records import Inputs, Located, Records

SAME_POSE = 1e-3
"""Most by which poses that were taken over differ from those that were given [mean distances]."""
LARGEST = 2.0**100  # factor of a unit; positions have limits of their own


def to_working_scale(inputs: Inputs) -> tuple[Inputs, Float[Tensor, "batch"]]:
    """The inputs in their own unit, and by what lengths were multiplied; 1 without poses."""
    factor = own_unit(inputs.photos)
    before = inputs.before
    if before is not None:
        stands = has_given_poses(before, inputs.photos)
        before = in_unit(before, torch.where(stands, factor, 1.0))
    photos, start = (
        _views_in_unit(views, factor) for views in (inputs.photos, inputs.start)
    )
    return replace(inputs, photos=photos, start=start, before=before), factor


def to_given_scale(
    records: Records, factor: Float[Tensor, "batch"], refined: bool = False
) -> Records:
    """The scene in the unit of its given poses, if it was made on them (`refined`: or from them).

    A reconstructor that looks for poses by itself has a unit of its own, which stays.
    """
    if bool((factor == 1).all()):
        return records
    back = 1 / factor
    inputs, made, judged = records.inputs, records.made, records.judged
    stands = has_given_poses(made.reconstruction, inputs.photos) | refined
    of_made = torch.where(stands, back, 1.0)
    depths = judged.rendered.depths
    if depths is not None:
        depths = _times(depths, of_made)
    photos, start, used, edited = (
        _views_in_unit(views, back)
        for views in (inputs.photos, inputs.start, made.photos, records.edit.views)
    )
    before = None if made.before is None else in_unit(made.before, of_made)
    reconstruction = in_unit(made.reconstruction, of_made)
    return replace(
        records,
        inputs=replace(inputs, photos=photos, start=start),
        located=_located_in_unit(records.located, back),
        edit=replace(records.edit, views=edited),
        made=replace(made, photos=used, before=before, reconstruction=reconstruction),
        gaussians=_gaussians_in_unit(records.gaussians, of_made),
        judged=replace(judged, rendered=replace(judged.rendered, depths=depths)),
    )


def _located_in_unit(located: Located, factor: Float[Tensor, "batch"]) -> Located:
    geometry = located.geometry
    if geometry is None:
        return located
    c2w = _poses_in_unit(geometry.c2w, factor)
    depths = _times(geometry.depths, factor)
    return replace(located, geometry=replace(geometry, c2w=c2w, depths=depths))


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
    poses = made.cameras.c2w.cpu().double()
    if given.shape != poses.shape:
        return torch.zeros(len(views.images), dtype=torch.bool)
    apart = (poses - given).abs()
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
