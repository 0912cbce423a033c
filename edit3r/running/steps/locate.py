"""Step 2: what the unedited photos tell, where the scene shall stand on it."""

from dataclasses import replace

import torch

from edit3r.contract.interfaces import Geometry
from edit3r.contract.reporting import note, say, stage
from edit3r.kit.geometry.cameras import field_of_view
from edit3r.kit.geometry.exposure import (
    Exposure,
    estimate_exposure,
    exposure_of_edit,
)
from edit3r.running.geometry import lies_flat
from edit3r.running.parts import Parts
from edit3r.running.records import (
    EditedPhotos,
    Inputs,
    Located,
    SelectedRegions,
    is_confined,
)


@torch.no_grad()
def locate(inputs: Inputs, parts: Parts) -> tuple[Inputs, Located]:
    """Read geometry and exposure from the photos before anything is edited.

    Where the reconstructor uses no geometry, nothing is read here: selecting may ask for it. EXIF
    that does not fit the photos is not believed. Raises MatchingError for photos that cannot be
    placed relative to each other.
    """
    if not parts.uses_geometry:
        _note_lens(inputs, None)
        return inputs, Located()
    with stage("geometry"):
        inputs, geometry = _fitting(inputs, parts)
        photos = inputs.photos
        flat = any(photos.assumed) and lies_flat(geometry, photos)
        lenses = _note_lens(inputs, geometry)
        exposure = _exposure(inputs, geometry, parts)
        return inputs, Located(geometry, flat, lenses, exposure)


@torch.no_grad()
def light_of_edit(
    inputs: Inputs,
    located: Located,
    selection: SelectedRegions,
    edit: EditedPhotos,
    parts: Parts,
) -> Located:
    """How the edited photos come into one light, where the photos were taken in several.

    What stands elsewhere after the edit, as behind a removed thing, follows the photos' light:
    their geometry does not tell what the edited photos share.
    """
    if located.exposure is None or parts.changes_shape:
        return located
    photos, edited = inputs.photos, edit.views
    changed = (edited.images != photos.images).any(2)
    geometry = parts.geometry.of(photos).geometry
    if geometry is None or not bool(changed.any()):
        return located
    # Inside the masks what an edit left as it was, as white under black and white, belongs to it.
    count = parts.edited_count(edited)
    masks = selection.masks
    region = masks > 0 if is_confined(masks) else torch.ones_like(changed)
    changed[:, :count] |= region[:, :count]
    exposure = exposure_of_edit(located.exposure, edited, changed, geometry)
    return replace(located, exposure_of_edit=exposure)


def _fitting(inputs: Inputs, parts: Parts) -> tuple[Inputs, Geometry]:
    """The geometry, and the inputs without what EXIF says of a lens that does not fit."""
    located = parts.geometry.of(inputs.photos)
    if not _by_exif(inputs) or (
        located.geometry is not None and not located.geometry.contradicts
    ):
        return inputs, located.required()
    unknown = (True,) * inputs.photos.count
    photos, start = (
        replace(views, assumed=unknown) for views in (inputs.photos, inputs.start)
    )
    geometry = parts.geometry.of(photos).geometry
    if geometry is None or geometry.intrinsics is None:
        return inputs, located.required()
    say(
        "lens.exif",
        "what EXIF says of the lens does not fit the photos, as where they were cropped; it is "
        "read from the photos instead, unless --fov tells it",
    )
    return replace(inputs, photos=photos, start=start), geometry


def _by_exif(inputs: Inputs) -> bool:
    """Whether EXIF alone tells the lens of all photos: photo apps keep it when they crop."""
    sources = [file.intrinsics_source for file in inputs.files]
    return bool(sources) and all(source.startswith("EXIF") for source in sources)


def _note_lens(inputs: Inputs, geometry: Geometry | None) -> tuple[float, float] | None:
    """Say in `run.json` who told the lens that is used; what is not sure about it."""
    sources = [file.intrinsics_source for file in inputs.files]
    photos = inputs.photos
    if not photos.assumed or not all(photos.assumed):
        geometry = None
    if geometry is not None and geometry.intrinsics is not None:
        fov = field_of_view(geometry.calibrated(photos))
        sources = [f"read from the photos: {fov:.1f} degrees across the longer side"]
    note("lens.source", list(dict.fromkeys(sources)))
    if geometry is None or geometry.lenses is None:
        return None
    note("lens.alike", [round(fov, 1) for fov in geometry.lenses])
    return geometry.lenses


def _exposure(inputs: Inputs, geometry: Geometry, parts: Parts) -> Exposure | None:
    """How the photos' colours become the first one's; pictures of a scene have one already."""
    if parts.config.exposure == "own" or inputs.scene is not None:
        return None
    exposure = estimate_exposure(inputs.photos, geometry)
    if exposure is not None:
        for name, value in (("gain", exposure.gain), ("offset", exposure.offset)):
            note(f"exposure.{name}", value[0, ..., 0, 0].tolist())
        say(
            "exposure",
            f"the photos differ by up to {255 * exposure.change:.0f} of 255; the scene has "
            "that of the first (--exposure own: each its own)",
        )
    return exposure
