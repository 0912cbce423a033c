"""Step 7: the scene seen from the photos' places, and the verdicts on scene and edit."""

from dataclasses import replace

import torch

from edit3r.contract.interfaces import HalfWay, Rasterizer, SceneToJudge
from edit3r.contract.reporting import stage
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering
from edit3r.contract.verdicts import EditVerdict
from edit3r.kit.checks import check_edit_verdict, check_verdict
from edit3r.kit.geometry.paths import half_way
from edit3r.kit.rendering import render_each
from edit3r.running.components import Components
from edit3r.running.editors import edit_to_judge
from edit3r.running.records import (
    EditedPhotos,
    ExposureCorrected,
    Inputs,
    Judged,
    Located,
    Reconstructed,
    SelectedRegions,
)
from edit3r.running.scene_input import SceneInput

HALF_WAY_SIZE = 256  # longer side [pixels]: critics look at no finer pictures


@torch.no_grad()
def judge(
    inputs: Inputs,
    located: Located,
    selection: SelectedRegions,
    edit: EditedPhotos,
    corrected: ExposureCorrected,
    reconstructed: Reconstructed,
    gaussians: Gaussians,
    components: Components,
) -> Judged:
    """The refined scene from its input views, and the verdicts."""
    text, size = "render input views", inputs.start.image_size
    with stage("check"):
        first, rendered = (
            corrected.undone(render_each(components.rasterizer, scene, cameras, text))
            for scene, cameras in (
                (reconstructed.reconstruction.gaussians, reconstructed.cameras),
                (gaussians, reconstructed.cameras.at(size)),
            )
        )
        cameras, half = reconstructed.cameras.at(size), None
        # Half-way between places around a scene is a place like any other.
        if cameras.count > 1 and inputs.scene is None:
            half = seen_half_way(components.rasterizer, gaussians, cameras)
        verdict = components.critic.judge_scene(
            SceneToJudge(
                photos=reconstructed.photos,
                placed=reconstructed.placed,
                geometry=located.geometry,
                edited=edit.views,
                first=first,
                rendered=rendered,
                measured=reconstructed.reconstruction.measured,
                flat=located.flat,
                lenses=located.lenses,
                edit=edit.verdict,
                half_way=half,
            )
        )
        check_verdict(components.critic, verdict)
        made = reconstructed.reconstruction
        if inputs.scene is not None and made.kept is not None:
            told = _compared(inputs.scene, made)
            verdict = replace(verdict, reason=f"{verdict.reason}; {told}")
        selection = replace(selection, masks=reconstructed.masks)
        edit_verdict = _edit_verdict(
            inputs, selection, edit, rendered, cameras, half, components
        )
    return Judged(rendered, verdict, edit_verdict)


def _compared(scene: SceneInput, made: Reconstruction) -> str:
    """What an edit in place did to the Gaussians of the given scene, as a clause."""
    kept, before = made.kept, scene.views.scene.gaussians
    assert kept is not None
    count = int(kept.sum())
    others = made.gaussians.harmonics[0, :count] != before.harmonics[0, kept]
    repainted = int(others.flatten(1).any(1).sum())
    told = [f"{repainted:,} of {before.count:,} Gaussians changed colour"]
    if count < before.count:
        told.append(f"{before.count - count:,} were taken out")
    if made.gaussians.count > count:
        told.append(f"{made.gaussians.count - count:,} are guesses of what was behind")
    return ", ".join((*told, "all others are as they came"))


def _edit_verdict(
    inputs: Inputs,
    selection: SelectedRegions,
    edit: EditedPhotos,
    rendered: Rendering,
    cameras: Cameras,
    half: HalfWay | None,
    components: Components,
) -> EditVerdict | None:
    """The verdict on the edit, with what the scene tells of it."""
    if edit.verdict is None:
        return None
    count = components.edited_count(inputs.start)
    asked = edit_to_judge(inputs, selection, edit, components.tasks, count)
    verdict = components.critic.judge_edit(
        replace(asked, rendered=rendered, cameras=cameras, half_way=half)
    )
    check_edit_verdict(components.critic, verdict)
    return verdict


def seen_half_way(
    rasterizer: Rasterizer, gaussians: Gaussians, cameras: Cameras
) -> HalfWay:
    """One scene (batch 1) from half-way between each photo and its nearest one."""
    share = min(1.0, HALF_WAY_SIZE / max(cameras.image_size))
    height, width = (max(1, round(share * side)) for side in cameras.image_size)
    between, pairs = half_way(cameras.at((height, width)))
    rendered = render_each(rasterizer, gaussians, between, "look between the photos")
    return HalfWay(rendered, between, pairs)
