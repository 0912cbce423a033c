"""Step 2: poses and depth of the unedited photos, which everything after it shares."""

from dataclasses import replace

import torch

from edit3r.contract.reporting import stage
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene
from edit3r.running.selecting.geometry import lies_flat


@torch.no_grad()
def locate(scene: Scene, parts: Parts) -> Scene:
    """Find the photos' geometry before anything is edited; `Parts` keeps it for later steps."""
    if parts.matcher is not None:
        with stage("geometry"):
            found = parts.located(scene.photos).geometry
            if any(scene.photos.assumed):
                scene = replace(scene, flat=lies_flat(found, scene.photos))
    return scene
