"""Step 2: poses and depths of the unedited photos, where the scene shall stand on them."""

from dataclasses import replace

import torch

from edit3r.contract.interfaces import Geometry
from edit3r.contract.reporting import note, say, stage
from edit3r.kit.geometry.cameras import field_of_view
from edit3r.running.geometry import lies_flat
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene


@torch.no_grad()
def locate(scene: Scene, parts: Parts) -> Scene:
    """Read the photos' geometry before anything is edited; later steps share it.

    Where the reconstructor uses none, nothing is read here: selecting may ask for it.
    """
    geometry = None
    if parts.uses_geometry:
        with stage("geometry"):
            geometry = parts.geometry.of(scene.photos).geometry
            if _by_exif(scene) and (geometry is None or geometry.contradicts):
                scene, geometry = _without_exif(scene, geometry, parts)
            if any(scene.photos.assumed):
                scene = replace(scene, flat=lies_flat(geometry, scene.photos))
    return _with_lens(scene, geometry)


def _by_exif(scene: Scene) -> bool:
    """Whether EXIF alone tells the lens of all photos: photo apps keep it when they crop."""
    told = [record.intrinsics_source for record in scene.records]
    return bool(told) and all(source.startswith("EXIF") for source in told)


def _without_exif(
    scene: Scene, geometry: Geometry | None, parts: Parts
) -> tuple[Scene, Geometry | None]:
    """The photos as if nobody knew their lens, where that is how they fit together."""
    unknown = (True,) * scene.photos.count
    photos, start = (
        replace(views, assumed=unknown) for views in (scene.photos, scene.start)
    )
    found = parts.geometry.of(photos).geometry
    if found is None or found.intrinsics is None:
        return scene, geometry
    say(
        "lens.exif",
        "what EXIF says of the lens does not fit the photos, as where they were cropped; it is "
        "read from the photos instead, unless --fov tells it",
    )
    return replace(scene, photos=photos, start=start), found


def _with_lens(scene: Scene, geometry: Geometry | None) -> Scene:
    """The scene with what is not sure about its lens; `run.json` says who told the lens."""
    told = [record.intrinsics_source for record in scene.records]
    unknown = bool(scene.photos.assumed) and all(scene.photos.assumed)
    found = geometry if unknown else None
    if found is not None and found.intrinsics is not None:
        fov = field_of_view(found.calibrated(scene.photos))
        told = [f"read from the photos: {fov:.1f} degrees across the longer side"]
    note("lens.source", list(dict.fromkeys(told)))
    if found is None or found.lenses is None:
        return scene
    note("lens.alike", [round(fov, 1) for fov in found.lenses])
    return replace(scene, lenses=found.lenses)
