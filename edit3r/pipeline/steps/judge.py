"""Step 6: the scene seen from the photos' places, and the verdicts on scene and edit."""

from dataclasses import replace

import torch

from edit3r.pipeline.edit_measures import measure_edit_in_3d
from edit3r.pipeline.edit_verdict import judge_edit
from edit3r.pipeline.parts import Parts
from edit3r.pipeline.rendering import render_each
from edit3r.pipeline.scene import Scene, known_cameras
from edit3r.pipeline.verdict import judge as judged
from edit3r.reporting import stage


@torch.no_grad()
def judge(scene: Scene, parts: Parts) -> Scene:
    """The refined scene from its input views, and the verdict."""
    text, reconstruction = "render input views", scene.reconstruction
    with stage("check"):
        first = render_each(
            parts.rasterizer,
            reconstruction.gaussians,
            known_cameras(reconstruction),
            text,
        )
        rendered = render_each(parts.rasterizer, scene.gaussians, scene.cameras, text)
        verdict = judged(
            scene.edited, first, rendered, scene.placed, reconstruction.measured
        )
        scene = replace(scene, rendered=rendered, verdict=verdict)
        return _with_edit_judged_in_3d(scene, parts)


def _with_edit_judged_in_3d(scene: Scene, parts: Parts) -> Scene:
    """The verdict on the edit, with what the scene tells of it."""
    verdict = scene.edit_verdict
    if verdict is None:
        return scene
    views = range(scene.start.count if parts.config.edit_views == "all" else 1)
    measures = measure_edit_in_3d(verdict.measures, scene, views)
    return replace(scene, edit_verdict=judge_edit(measures, verdict.surety))
