"""Step 4: the 2D edit of the views, held to the masks, and what can be said of it."""

from collections.abc import Sequence
from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Editor, EditsRegions
from edit3r.contract.reporting import note, say, stage, warn
from edit3r.contract.types import EditRequest, Views
from edit3r.kit.checks import check_edit, errors_named_after
from edit3r.kit.geometry.maps import composite
from edit3r.running.editors import request_of
from edit3r.running.in_place import InPlace, put_in_place
from edit3r.running.judging.edit_measures import measure_edit
from edit3r.running.judging.edit_verdict import judge_edit
from edit3r.running.parts import Parts
from edit3r.running.scene import Scene


@torch.no_grad()
def edit(scene: Scene, parts: Parts) -> Scene:
    """Edit all views, or the first alone, one editor after the other."""
    config, views = parts.config, scene.start
    with stage(f"edit ({parts.editor_names})"):
        count = views.count if config.edit_views == "all" else 1
        chosen = views.select(range(count))
        edited, done, found = chosen, 0, []
        for task in parts.tasks:
            request = request_of(
                task, scene, config.seed, range(done, done + len(task.wishes))
            ).of_views(range(count))
            answer = _answer(task.editor, edited, request)
            if config.moved_edits == "undo":
                found.append(_in_place(edited, answer, request.masks))
                answer = replace(answer, images=found[-1].images)
            edited = _held_to_masks(task.editor, edited, answer, request.masks)
            done += len(task.wishes)
        _note_change(edited, chosen)
        images = edited.images
        if count < views.count:
            images = torch.cat((images, views.images[:, count:]), dim=1)
        scene = replace(scene, edited=replace(views, images=images))
        return _with_edit_verdict(scene, parts, range(count), found)


def _with_edit_verdict(
    scene: Scene, parts: Parts, views: Sequence[int], found: Sequence[InPlace]
) -> Scene:
    """The scene with what can be said of the edit of these views before anything is in 3D."""
    if not parts.config.prompt and torch.equal(scene.edited.images, scene.start.images):
        return scene
    wishes = scene.wishes or [wish for task in parts.tasks for wish in task.wishes]
    measures = measure_edit(scene, wishes, views)
    faults = [fault for one in found for fault in one.faults]
    moved = tuple(clause for one in found for clause in one.moved)
    measures = replace(measures, faults=(*faults, *measures.faults), moved=moved)
    verdict = judge_edit(measures, _surety(scene))
    if verdict.label == "doubtful":
        warn(f"the edit is doubtful: {verdict.reason}.")
    return replace(scene, edit_verdict=verdict)


def _answer(editor: Editor, views: Views, request: EditRequest) -> Views:
    """The editor's answer, held to its contract."""
    with errors_named_after(editor, views.images):
        answer = editor.edit(views, request)
    check_edit(editor, views, answer)
    return answer


def _in_place(views: Views, answer: Views, masks: Tensor | None) -> InPlace:
    """The answer with what moved moved back, and what is wrong with the rest."""
    found = put_in_place(views.images, answer.images, views.called, masks is not None)
    if found.moved:
        clauses = "; ".join(found.moved)
        say("edit.moved_back", f"{clauses} (--moved-edits keep: as it is)")
    return found


def _held_to_masks(
    editor: Editor, views: Views, answer: Views, masks: Tensor | None
) -> Views:
    """The answer with the pixels outside the masks as they were."""
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


def _note_change(edited: Views, views: Views) -> None:
    pairs = zip(edited.images.unbind(1), views.images.unbind(1))
    per_view = [float((after - before).abs().mean()) for after, before in pairs]
    note("edit.mean_change_per_view", [round(value, 5) for value in per_view])


def _surety(scene: Scene) -> float | None:
    """How surely the least sure thing was found, None where everything was marked; 0: a guess."""
    sureties = [one.surety for one in scene.selected if one.surety is not None]
    if any("guess" in one.how for one in scene.selected):
        sureties.append(0.0)
    return min(sureties, default=None)
