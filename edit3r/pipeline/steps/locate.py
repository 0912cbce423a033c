"""Step 2: poses and depth of the unedited photos, which everything after it shares."""

import torch

from edit3r.pipeline.parts import Parts
from edit3r.pipeline.scene import Scene
from edit3r.reporting import stage


@torch.no_grad()
def locate(scene: Scene, parts: Parts) -> Scene:
    """Find the photos' geometry before anything is edited; `Parts` keeps it for later steps."""
    if parts.matcher is not None:
        with stage("geometry"):
            parts.located(scene.photos)
    return scene
