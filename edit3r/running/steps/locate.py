"""Step 2: poses and depth of the unedited photos, which everything after it shares."""

import torch

from edit3r.contract.reporting import stage
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene


@torch.no_grad()
def locate(scene: Scene, parts: Parts) -> Scene:
    """Find the photos' geometry before anything is edited; `Parts` keeps it for later steps."""
    if parts.matcher is not None:
        with stage("geometry"):
            parts.located(scene.photos)
    return scene
