"""Step 2: what the unedited photos tell, where the scene shall stand on it."""

from dataclasses import replace

import torch

from edit3r.contract.interfaces import Geometry, MatchesCorrected
from edit3r.contract.reporting import note, say, stage
from edit3r.contract.types import Views
from edit3r.kit.geometry.cameras import field_of_view
from edit3r.kit.geometry.exposure import Exposure, estimate_exposure
from edit3r.running.components import Components
from edit3r.running.geometry import GeometryAnswer, find_geometry, lies_flat
from edit3r.running.records import READ_LENS, Inputs, Located


@torch.no_grad()
def locate(inputs: Inputs, components: Components) -> tuple[Inputs, Located]:
    """Read geometry and exposure from the photos before anything is edited.

    Where the reconstructor uses no geometry, nothing is read here: selecting may ask for it. EXIF
    that does not fit the photos is not believed. Raises MatchingError for photos that cannot be
    placed relative to each other.
    """
    if not components.uses_geometry:
        _note_lens(inputs, None)
        return inputs, Located()
    with stage("geometry"):
        inputs, answer = _fitting(inputs, components)
        photos, geometry = inputs.photos, answer.required()
        flat = any(photos.assumed) and lies_flat(geometry, photos)
        fov_range = _note_lens(inputs, geometry)
        exposure = _exposure(photos, geometry, components)
        corrected, source = None, components.geometry_source
        if exposure is not None and isinstance(source, MatchesCorrected):
            shown = replace(photos, images=exposure.to_reference(photos.images))
            corrected = find_geometry(source, photos, shown).required()
        return inputs, Located(answer, corrected, flat, fov_range, exposure)


def _fitting(inputs: Inputs, components: Components) -> tuple[Inputs, GeometryAnswer]:
    """The geometry, and the inputs without what EXIF says of a lens that does not fit."""
    source = components.geometry_source
    answer = find_geometry(source, inputs.photos)
    if not _by_exif(inputs) or (
        answer.geometry is not None and not answer.geometry.contradicting_fov
    ):
        return inputs, answer
    unknown = (True,) * inputs.photos.count
    photos, start = (
        replace(views, assumed=unknown) for views in (inputs.photos, inputs.start)
    )
    read = find_geometry(source, photos)
    if read.geometry is None or read.geometry.intrinsics is None:
        return inputs, answer
    say(
        "lens.exif",
        "what EXIF says of the lens does not fit the photos, perhaps because they were "
        "cropped; it is estimated from the photos instead, unless --fov is given",
    )
    return replace(inputs, photos=photos, start=start), read


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
        sources = [f"{READ_LENS}: {fov:.1f} degrees across the longer side"]
    note("lens.source", list(dict.fromkeys(sources)))
    if geometry is None or geometry.fov_range is None:
        return None
    note("lens.alike", [round(fov, 1) for fov in geometry.fov_range])
    return geometry.fov_range


def _exposure(
    photos: Views, geometry: Geometry, components: Components
) -> Exposure | None:
    """How the photos' colours become the first one's."""
    if components.config.exposure == "own":
        return None
    exposure = estimate_exposure(photos, geometry)
    if exposure is not None:
        for name, value in (("gain", exposure.gain), ("offset", exposure.offset)):
            note(f"exposure.{name}", value[0, ..., 0, 0].tolist())
        say(
            "exposure",
            f"the photos differ by up to {255 * exposure.change:.0f} of 255; the scene "
            "takes the exposure of the first (--exposure own keeps each)",
        )
    return exposure
