"""Step 4: the 2D edit of the views, held to the masks, and what can be said of it."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Editor, EditsRegions
from edit3r.contract.reporting import note, say, stage, warn
from edit3r.contract.types import Views
from edit3r.contract.verdicts import EditVerdict
from edit3r.kit import asking
from edit3r.kit.geometry.maps import composite, feathered
from edit3r.running.components import Components
from edit3r.running.edit_alignment import AlignedEdit, align_edit
from edit3r.running.editors import edit_to_judge, request_of
from edit3r.running.records import EditedPhotos, Inputs, SelectedRegions


@torch.no_grad()
def edit(
    inputs: Inputs, selection: SelectedRegions, components: Components
) -> EditedPhotos:
    """Edit all views, or the first alone, one editor after the other."""
    with stage(f"edit ({components.editor_names})"):
        edited = edit_alone(inputs, selection, components)
        verdict = _verdict(inputs, selection, edited, components)
        return replace(edited, verdict=verdict)


@torch.no_grad()
def edit_alone(
    inputs: Inputs, selection: SelectedRegions, components: Components
) -> EditedPhotos:
    """The same without a verdict."""
    config, views = components.config, inputs.start
    count = components.edited_count(views)
    chosen = views.select(range(count))
    edited, done = chosen, 0
    faults: list[str] = []
    moved: list[str] = []
    for task in components.tasks:
        instructions = range(done, done + len(task.instructions))
        request = request_of(task, selection, config.seed, instructions)
        request = request.of_views(range(count))
        answer = asking.edit(task.editor, edited, request)
        # Moving an edit back may carry the photo's own pixels into it.
        hides = {*instructions} & {*components.hiding}
        if config.moved_edits == "undo" and not hides:
            aligned = _in_place(edited, answer, request.masks)
            faults += aligned.faults
            moved += aligned.moved
            answer = replace(answer, images=aligned.images)
        edited = _held_to_masks(task.editor, edited, answer, request.masks)
        done += len(task.instructions)
    edited = _in_part(chosen, edited, selection.masks, components)
    _note_change(edited, chosen)
    images = edited.images
    if count < views.count:
        images = torch.cat((images, views.images[:, count:]), dim=1)
    return EditedPhotos(replace(views, images=images), tuple(faults), tuple(moved))


def _in_part(
    views: Views, edited: Views, masks: Tensor | None, components: Components
) -> Views:
    """As much of the edit as `strength` and `feather` ask for."""
    config = components.config
    if config.strength == 1 and (masks is None or not config.feather):
        return edited
    weights = torch.ones_like(views.images[:, :, 0])
    if masks is not None and config.feather:
        weights = feathered(masks[:, : views.count], config.feather)
    images = composite(views.images, edited.images, config.strength * weights)
    return replace(edited, images=images)


def _verdict(
    inputs: Inputs,
    selection: SelectedRegions,
    edited: EditedPhotos,
    components: Components,
) -> EditVerdict | None:
    """What can be said of the edit before anything is in 3D; None where none was asked for."""
    if not components.config.prompt and torch.equal(
        edited.views.images, inputs.start.images
    ):
        return None
    count = components.edited_count(inputs.start)
    asked = edit_to_judge(inputs, selection, edited, components.tasks, count)
    verdict = asking.judge_edit(components.critic, asked)
    if verdict.label == "doubtful":
        warn(f"the edit is doubtful: {verdict.reason}.")
    return verdict


def _in_place(views: Views, answer: Views, masks: Tensor | None) -> AlignedEdit:
    """The answer with what moved moved back, and what is wrong with the rest."""
    aligned = align_edit(views.images, answer.images, views.called, masks is not None)
    if aligned.moved:
        clauses = "; ".join(aligned.moved)
        say("edit.moved_back", f"{clauses} (--moved-edits keep leaves them)")
    return aligned


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
