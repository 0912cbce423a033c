"""Step 2: poses and depth of the unedited photos, which everything after it shares."""

from dataclasses import replace

import torch

from edit3r.contract.interfaces import MatchedGeometry
from edit3r.contract.reporting import note, stage
from edit3r.kit.geometry.cameras import field_of_view
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene
from edit3r.running.selecting.geometry import lies_flat


@torch.no_grad()
def locate(scene: Scene, parts: Parts) -> Scene:
    """Find the photos' geometry before anything is edited; `Parts` keeps it for later steps."""
    geometry = None
    if parts.matcher is not None:
        with stage("geometry"):
            geometry = parts.located(scene.photos).geometry
            if any(scene.photos.assumed):
                scene = replace(scene, flat=lies_flat(geometry, scene.photos))
    return _with_lens(scene, geometry)


def _with_lens(scene: Scene, geometry: MatchedGeometry | None) -> Scene:
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
