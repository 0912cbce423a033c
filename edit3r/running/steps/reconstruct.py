"""Step 5: Gaussians and cameras of the edited views, and the scene before the edit."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor

from edit3r.contract.component import component_name
from edit3r.contract.interfaces import (
    ComparesWithBefore,
    EditsViews,
    Geometry,
    Reconstructor,
)
from edit3r.contract.reporting import note, stage, warn
from edit3r.contract.types import Cameras, Reconstruction, Views
from edit3r.kit import asking
from edit3r.kit.cache import recall
from edit3r.kit.geometry.cameras import quarter_turns
from edit3r.kit.geometry.maps import dilate
from edit3r.kit.geometry.pose import estimate_cameras
from edit3r.running.components import Components
from edit3r.running.editors import request_of
from edit3r.running.geometry import find_geometry
from edit3r.running.records import (
    EditedPhotos,
    ExposureCorrected,
    Inputs,
    Located,
    Masks,
    Reconstructed,
    SelectedRegions,
    is_confined,
    known_cameras,
)

FINE_VIEWS = 20
"""Views whose grids are as fine as asked for: more have as many pixels together, since they show
the same surfaces again, and memory must hold them.
"""

AROUND = 0.01
"""How far around what changed depth is still that of what was there [long sides]. By eye, on one
pair; no figure kept.
"""


@torch.no_grad()
def reconstruct(
    inputs: Inputs,
    located: Located,
    corrected: ExposureCorrected,
    selection: SelectedRegions,
    edit: EditedPhotos,
    components: Components,
) -> Reconstructed:
    """Gaussians and cameras of the edited views, and the scene as it was before the edit."""
    with stage(f"reconstruct ({component_name(components.reconstructor)})"):
        scene = _reconstruction(inputs, located, corrected, selection, edit, components)
        masks = _masks_of_change(inputs, selection, edit, components)
        before = _before(inputs, located, corrected, masks, components)
    if before is not None:
        cameras = known_cameras(before).at(known_cameras(scene).image_size)
        scene = replace(scene, cameras=cameras)
    placed = _placed(scene, inputs.photos.count)
    used = [view for view, there in enumerate(placed) if there]
    _tell_of_turned(inputs.photos.select(used), known_cameras(scene))
    return Reconstructed(
        reconstruction=scene,
        photos=inputs.photos,
        placed=placed,
        masks=None if masks is None else masks[:, used],
        before=before,
    )


def _tell_of_turned(photos: Views, cameras: Cameras) -> None:
    """Warn of photos that lie on their side beside the others: what was wide there was cut off."""
    turns = quarter_turns(cameras.c2w[0])
    for quarters, way in enumerate(("to the left", "by a half", "to the right"), 1):
        turned = photos.select((turns == quarters).nonzero()[:, 0].tolist())
        if turned.count:
            warn(
                f"{', '.join(turned.names) or 'A photo'}: turned on its side, so part of it may be "
                f"cut off and things are hard to recognise. Turn the file {way} and run again."
            )


def _reconstruction(
    inputs: Inputs,
    located: Located,
    corrected: ExposureCorrected,
    selection: SelectedRegions,
    edit: EditedPhotos,
    components: Components,
) -> Reconstruction:
    """The edited views in 3D; their geometry is that of the photos, unless things come or go."""
    recon, edited = components.reconstructor, corrected.edited
    source, geometry = corrected.photos, located.to_build_on
    if components.changes_shape:
        source = edited
        if components.uses_geometry:
            changed = (edit.views.images != inputs.start.images).any(2)
            geometry = _after_edit(edited, changed, geometry, components)
    if not isinstance(recon, EditsViews):
        grid = _grid(components, edited)
        return _checked(recon, edited, lambda: recon(edited, source, geometry, grid))
    task = components.whole_task
    instructions = range(len(task.instructions))
    request = request_of(task, selection, components.config.seed, instructions)
    return _checked(
        recon,
        edited,
        lambda: recon.edit_and_reconstruct(edited, source, request, geometry),
    )


def _after_edit(
    edited: Views,
    changed: Bool[Tensor, "batch view height width"],
    of_photos: Geometry | None,
    components: Components,
) -> Geometry:
    """The geometry of edited views in which things came or went where they `changed`.

    Views that share too little to be placed anew, as after a large removal, stand where their
    photos do, since no camera moved: depth is that of the photos, and goes on from around where
    something changed. Raises MatchingError where the photos have no place either, or all changed.
    """
    answer = find_geometry(components.geometry_source, edited)
    if answer.geometry is not None or of_photos is None:
        return answer.required()
    hole = dilate(changed.to(edited.images), round(AROUND * max(edited.image_size))) > 0
    if bool(hole.flatten(2).all(-1).any()):
        return answer.required()
    warn(
        "the edited photos share too little to be placed anew: they keep the photos' cameras, and "
        "what came or went has the depth of what is around it."
    )
    inverse = (1 / of_photos.depths).flatten(0, 1).numpy(force=True)
    holes = hole.flatten(0, 1).numpy(force=True).astype(np.uint8)
    filled = [cv2.inpaint(*one, 1, cv2.INPAINT_NS) for one in zip(inverse, holes)]
    depths = 1 / torch.from_numpy(np.stack(filled)).to(of_photos.depths)
    confidence = of_photos.confidence.masked_fill(hole, 0)
    return replace(of_photos, depths=depths.view_as(hole), confidence=confidence)


def _grid(components: Components, views: Views) -> tuple[int, int]:
    """(height, width) of the grid of Gaussians: coarser than the views where refining follows."""
    refined = components.config.refine and not components.reconstructor.fuses_by_itself
    fine = min(1.0, (FINE_VIEWS / views.count) ** 0.5)
    share = components.config.grid * fine if refined else 1.0
    height, width = views.image_size
    return max(1, round(share * height)), max(1, round(share * width))


def _checked(
    recon: Reconstructor, views: Views, compute: Callable[[], Reconstruction]
) -> Reconstruction:
    """The answer, held to the contract, with cameras by PnP where it predicts none, and without
    what could not be placed.
    """
    reconstruction = asking.reconstruct(recon, views, compute)
    if reconstruction.cameras is None:
        note("cameras", "PnP on the predicted Gaussian centres")
        per_pixel = reconstruction.per_pixel
        cameras = estimate_cameras(reconstruction.gaussians, views, per_pixel)
        reconstruction = replace(reconstruction, cameras=cameras)
    return _only_placed(reconstruction)


def _placed(reconstruction: Reconstruction, views: int) -> tuple[bool, ...]:
    """For each view whether it was placed in every scene of the batch."""
    if reconstruction.placed is None:
        return (True,) * views
    return tuple(reconstruction.placed.all(0).tolist())


def _only_placed(reconstruction: Reconstruction) -> Reconstruction:
    """The reconstruction without the Gaussians and cameras of views that could not be placed."""
    if reconstruction.placed is None or bool(reconstruction.placed.all()):
        return reconstruction
    count = reconstruction.placed.shape[1]
    placed = _placed(reconstruction, count)
    used = [view for view, there in enumerate(placed) if there]
    gaussians, cameras = reconstruction.gaussians, known_cameras(reconstruction)
    measured, fusion = reconstruction.measured, reconstruction.fusion
    # The new index of each view; the last entry is for Gaussians of no view, whose index is -1.
    new_index = torch.full((count + 1,), -1, device=gaussians.means.device)
    new_index[used] = torch.arange(len(used), device=new_index.device)
    of_placed = gaussians.select(
        (new_index[gaussians.view_index] >= 0) | (gaussians.view_index < 0)
    )
    return replace(
        reconstruction,
        gaussians=replace(of_placed, view_index=new_index[of_placed.view_index]),
        cameras=cameras.select(used),
        measured=measured[:, used] if measured is not None else None,
        fusion=fusion[:, used] if fusion is not None else None,
    )


def _masks_of_change(
    inputs: Inputs,
    selection: SelectedRegions,
    edit: EditedPhotos,
    components: Components,
) -> Masks | None:
    """Where the scene may change: the masks, else, after an earlier run, where the images did.

    Views that were not edited hold nothing back.
    """
    if selection.masks is not None or inputs.before is None:
        return selection.masks
    start = inputs.start.images
    changed = (edit.views.images != start).any(2).to(start)
    changed[:, components.edited_count(inputs.start) :] = 1
    return changed


def _before(
    inputs: Inputs,
    located: Located,
    corrected: ExposureCorrected,
    masks: Masks | None,
    components: Components,
) -> Reconstruction | None:
    """The scene as it was before the edit, where a refiner needs it and some of it must stay."""
    needed = any(
        isinstance(refiner, ComparesWithBefore) for refiner in components.refiners
    )
    if not needed or components.changes_shape or not is_confined(masks):
        return None
    if components.edits_again:  # an earlier run's, unless it shows what is hidden
        return inputs.before
    recon, photos = components.reconstructor, corrected.photos
    if isinstance(recon, EditsViews):
        # It has no answer for photos that are not to be edited.
        return None
    geometry, grid = located.to_build_on, _grid(components, photos)

    def compute() -> Reconstruction:
        return _checked(recon, photos, lambda: recon(photos, photos, geometry, grid))

    return recall("before", recon, (photos, geometry, grid), compute)
