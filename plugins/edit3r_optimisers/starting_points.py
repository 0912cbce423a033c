"""Where a fit begins: another reconstructor's Gaussians, thinned."""

from dataclasses import replace

import torch

from edit3r.geometry.pose import estimate_cameras
from edit3r.interfaces import Reconstructor
from edit3r.reporting import note
from edit3r.stage_checks import check_reconstruction, errors_named_after
from edit3r.types import Cameras, Gaussians, Views

VISIBLE_OPACITY = 0.05  # a fainter first Gaussian has next to no gradient and would never show what it is worth


def begin(photos: Views, reconstructor: Reconstructor, most: int, seed: int) -> tuple[Gaussians, Cameras]:
    """Return at most `most` first Gaussians of one scene's unedited photos (batch 1), and the photos' cameras.

    Both are in view 0's frame. Raises MatchingError where the reconstructor cannot place the photos.
    """
    with errors_named_after(reconstructor):
        answer = reconstructor(photos, source=photos)
    check_reconstruction(reconstructor, photos, answer)
    cameras = answer.cameras or estimate_cameras(answer.gaussians, photos)
    gaussians = thinned(answer.gaussians.select(answer.gaussians.opacities[0] > 0), most, seed)
    note("refit.first_gaussians", gaussians.count)
    return replace(gaussians, opacities=gaussians.opacities.clamp(min=VISIBLE_OPACITY)), cameras


def thinned(gaussians: Gaussians, most: int, seed: int) -> Gaussians:
    """Choose at most `most` Gaussians at random and widen them so that they still cover their surfaces."""
    if gaussians.count <= most:
        return gaussians
    order = torch.randperm(gaussians.count, generator=torch.Generator().manual_seed(seed))
    chosen = gaussians.select(order[:most].sort().values.to(gaussians.means.device))
    return replace(chosen, scales=chosen.scales * (gaussians.count / most) ** 0.5)
