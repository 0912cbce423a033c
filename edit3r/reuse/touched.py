"""Reconstruction after an edit, changed only where the edit touches the pictures."""

from collections.abc import Callable

import torch
from edit3r_refiners.keep_outside_mask import Region, graft

from edit3r.interfaces import Rasterizer, Reconstructor
from edit3r.reporting import note, warn
from edit3r.reuse.memory import Memory
from edit3r.reuse.parts import remembered_reconstruction
from edit3r.types import EditRequest, Reconstruction, Views

Reconstruct = Callable[[Views], Reconstruction]


def touched_region(start: Views, edited: Views, request: EditRequest, edited_views: int, again: bool) -> Region | None:
    """Pixels where the scene may change; None: everywhere.

    Masks say it. Without them, an edit of an earlier run's scene (`again`) may change what it changed on the pictures;
    views that were not edited (all but the first `edited_views`) then hold nothing back.
    """
    if edited.images.shape[0] != 1:
        if request.masks is not None:
            warn("several scenes at once: the Gaussians outside the masks are reconstructed anew, not kept.")
        return None
    if request.masks is not None:
        region = request.masks[0] > 0
    elif again:
        region = (edited.images[0] != start.images[0]).any(1)
        region[edited_views:] = True
    else:
        return None
    return None if region.all() else region


def reconstruct_touched(
    reconstruct: Reconstruct,
    edited: Views,
    region: Region,
    before: Reconstruction,
    rasterizer: Rasterizer,
) -> Reconstruction:
    """`before`, with the Gaussians inside the region from the reconstruction of `edited`."""
    note("reuse.region_share", round(float(region.float().mean()), 4))
    after = reconstruct(edited).gaussians
    with torch.no_grad():
        grafted = graft(before.gaussians, after, region, before.cameras, rasterizer)
    return Reconstruction(grafted.gaussians, before.cameras)


def unedited(reconstruct: Reconstruct, reconstructor: Reconstructor, photos: Views, memory: Memory) -> Reconstruction:
    """The reconstruction of the photos as they are, remembered."""
    return remembered_reconstruction(memory, reconstructor, photos, lambda: reconstruct(photos))
