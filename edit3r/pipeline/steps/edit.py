"""Step 3: the 2D edit of the views, held to the masks, and what can be said of it."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Editor, EditsRegions
from edit3r.contract.types import EditRequest, Views
from edit3r.geometry.maps import composite
from edit3r.pipeline.checks import check_edit, errors_named_after
from edit3r.pipeline.edit_measures import measure_edit
from edit3r.pipeline.edit_verdict import judge_edit
from edit3r.pipeline.editors import request_of
from edit3r.pipeline.parts import Parts
from edit3r.pipeline.scene import Scene
from edit3r.reporting import note, stage, warn

MIN_VISIBLE_CHANGE = (
    2 / 255
)  # mean absolute change; below it an edit is said to have done nothing


@torch.no_grad()
def edit(scene: Scene, parts: Parts) -> Scene:
    """Edit all views, or the first alone, one editor after the other."""
    config, views = parts.config, scene.start
    with stage(f"edit ({parts.editor_names})"):
        count = views.count if config.edit_views == "all" else 1
        chosen = views.select(range(count))
        edited, done = chosen, 0
        for task in parts.tasks:
            request = request_of(
                task, scene, config.seed, range(done, done + len(task.wishes))
            )
            edited = _edited(task.editor, edited, request.of_views(range(count)))
            done += len(task.wishes)
        _note_change(edited.images - chosen.images, config.prompt)
        images = torch.cat((edited.images, views.images[:, count:]), dim=1)
        scene = replace(scene, edited=replace(views, images=images))
        return _with_edit_verdict(scene, parts, range(count))


def _with_edit_verdict(scene: Scene, parts: Parts, views: Sequence[int]) -> Scene:
    """The scene with what can be said of the edit of these views before anything is in 3D."""
    if not parts.config.prompt and torch.equal(scene.edited.images, scene.start.images):
        return scene
    wishes = scene.wishes or [wish for task in parts.tasks for wish in task.wishes]
    measures = measure_edit(scene, wishes, views)
    verdict = judge_edit(measures, _surety(scene))
    if verdict.label == "doubtful":
        warn(f"the edit is doubtful: {verdict.reason}.")
    return replace(scene, edit_verdict=verdict)


def _edited(editor: Editor, views: Views, request: EditRequest) -> Views:
    """The editor's answer, held to its contract, with the pixels outside the masks as they were."""
    with errors_named_after(editor):
        answer = editor.edit(views, request)
    check_edit(editor, views, answer)
    masks = request.masks
    if masks is None:
        return replace(views, images=answer.images)
    _note_spill(views, answer, masks)
    if isinstance(editor, EditsRegions):  # it blends by its regions itself
        masks = (masks > 0).to(masks)
    return replace(views, images=composite(views.images, answer.images, masks))


def _note_spill(
    views: Views, answer: Views, masks: Float[Tensor, "batch view height width"]
) -> None:
    """Note how much the editor changed where nothing may change."""
    outside = masks == 0
    change = (answer.images - views.images).abs().mean(2)
    mean = (change * outside).sum() / outside.sum().clamp(min=1)
    note("edit.change_outside_mask_before_composite", float(mean))


def _note_change(
    change: Float[Tensor, "batch view 3 height width"], prompt: str
) -> None:
    per_view = change.abs().mean((0, 2, 3, 4))
    note("edit.mean_change_per_view", [round(float(value), 5) for value in per_view])
    mean = float(change.abs().mean())
    if prompt and mean < MIN_VISIBLE_CHANGE:
        warn(f"the edit changed the photos very little (mean {255 * mean:.1f} of 255).")


def _surety(scene: Scene) -> float | None:
    """How surely the least sure thing was found, None where everything was marked; 0: a guess."""
    sureties = [one.surety for one in scene.selected if one.surety is not None]
    if any("guess" in one.how for one in scene.selected):
        sureties.append(0.0)
    return min(sureties, default=None)
