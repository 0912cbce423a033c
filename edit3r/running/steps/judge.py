"""Step 7: the scene seen from the photos' places, and the verdicts on scene and edit."""

from dataclasses import replace

import torch

from edit3r.contract.reporting import stage
from edit3r.contract.types import Rendering
from edit3r.kit.rendering import render_each
from edit3r.running.judging.edit_measures import measure_edit_in_3d
from edit3r.running.judging.edit_verdict import judge_edit
from edit3r.running.judging.verdict import judge as judged
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene, known_cameras


@torch.no_grad()
def judge(scene: Scene, parts: Parts) -> Scene:
    """The refined scene from its input views, and the verdict."""
    text, reconstruction = "render input views", scene.reconstruction
    with stage("check"):
        first, rendered = (
            _in_own_light(
                render_each(parts.rasterizer, gaussians, cameras, text), scene
            )
            for gaussians, cameras in (
                (reconstruction.gaussians, known_cameras(reconstruction)),
                (scene.gaussians, scene.cameras),
            )
        )
        verdict = judged(
            scene.edited, first, rendered, scene.placed, reconstruction.measured
        )
        verdict = verdict.with_lens_unsure(scene.lenses)
        scene = replace(scene, rendered=rendered, verdict=verdict)
        return _with_edit_judged_in_3d(scene, parts)


def _in_own_light(rendering: Rendering, scene: Scene) -> Rendering:
    """The scene from the photos' places, in the light in which each photo was taken."""
    if scene.light is None:
        return rendering
    return replace(rendering, images=scene.light.to_own(rendering.images))


def _with_edit_judged_in_3d(scene: Scene, parts: Parts) -> Scene:
    """The verdict on the edit, with what the scene tells of it."""
    verdict = scene.edit_verdict
    if verdict is None:
        return scene
    views = range(scene.start.count if parts.config.edit_views == "all" else 1)
    measures = measure_edit_in_3d(verdict.measures, scene, views)
    return replace(scene, edit_verdict=judge_edit(measures, verdict.surety))
