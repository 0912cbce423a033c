"""Between steps 4 and 5: the photos, before and after the edit, in one light."""

from dataclasses import replace

import torch

from edit3r.kit.geometry.exposure import Exposure, ExposureOfEdit, exposure_of_edit
from edit3r.running.components import Components
from edit3r.running.records import (
    EditedPhotos,
    ExposureCorrected,
    Inputs,
    Located,
    SelectedRegions,
    is_confined,
)


@torch.no_grad()
def correct_exposure(
    inputs: Inputs,
    located: Located,
    selection: SelectedRegions,
    edit: EditedPhotos,
    components: Components,
) -> ExposureCorrected:
    """The photos before and after the edit in the first one's exposure.

    What was edited may follow other light than the photos (`exposure_of_edit`). What stands
    elsewhere after the edit, as behind a removed thing, follows the photos' light: their geometry
    does not tell what the edited photos share.
    """
    photos, edited, exposure = inputs.photos, edit.views, located.exposure
    if exposure is None:
        return ExposureCorrected(photos, edited)
    of_edit: Exposure | ExposureOfEdit = exposure
    changed = (edited.images != photos.images).any(2)
    geometry = located.geometry
    if not components.changes_shape and geometry is not None and bool(changed.any()):
        # Inside the masks what an edit left as it was, as white under black and white, belongs to
        # it.
        count = components.edited_count(edited)
        masks = selection.masks
        region = masks > 0 if is_confined(masks) else torch.ones_like(changed)
        changed[:, :count] |= region[:, :count]
        of_edit = exposure_of_edit(exposure, edited, changed, geometry)
    return ExposureCorrected(
        replace(photos, images=exposure.to_reference(photos.images)),
        replace(edited, images=of_edit.to_reference(edited.images)),
        of_edit,
    )
