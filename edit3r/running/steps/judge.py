"""Step 7: the scene seen from the photos' places, and the verdicts on scene and edit."""

from dataclasses import replace

import torch

from edit3r.contract.reporting import stage
from edit3r.contract.types import Rendering
from edit3r.kit.rendering import render_each
from edit3r.running.judging.edit_measures import measure_edit_in_3d
from edit3r.running.judging.edit_verdict import judge_edit
from edit3r.running.judging.verdict import Doubt, judge as judged
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene, known_cameras

FLAT = (
    "all that the photos share lies on one plane: a flat thing, or photos from one place. Take a "
    "step to the side between photos, or tell the lens (--fov)"
)
UNSURE_LENS = (
    "the lens is not sure: fields of view from {:.0f} to {:.0f} degrees explain the photos alike. "
    "Give --fov if you know it, or more photos from other sides"
)
MOVED = (
    "the 2D edits had moved against their photos and were moved back, which cannot bring back what "
    "left the picture. Let the editor leave everything where it is"
)


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
            scene.edited,
            first,
            rendered,
            scene.placed,
            reconstruction.measured,
            doubt_of(scene),
            scene.passing,
            scene.guessed,
        )
        scene = replace(scene, rendered=rendered, verdict=verdict)
        return _with_edit_judged_in_3d(scene, parts)


def doubt_of(scene: Scene) -> Doubt | None:
    """What else speaks against the scene: its edits, or photos that tell no depth or no lens."""
    edit = scene.edit_verdict
    if edit is not None and edit.measures.faults:
        return Doubt("the 2D edits do not show what their photos show (see the edit)")
    if scene.flat:
        return Doubt(FLAT)
    if scene.lenses is not None:
        return Doubt(UNSURE_LENS.format(*scene.lenses))
    if edit is not None and edit.measures.moved:
        return Doubt(MOVED, best="good")
    return None


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
