"""One run end to end, as a table of contents: photos, edit, reconstruct, check, simplify, refine.

    photos --> editor --> composite with the masks --> reconstructor (photos beside) --> Gaussians, cameras
               what the edit does not touch stays as in the unedited, or the earlier, scene --> Gaussians
                                          Gaussians --> simplify --> refine --> Gaussians   (both when asked for)

Writing the results to disk is `edit3r.results`; the command line is a thin shell over both.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import torch
from edit3r_refiners.refine import refine as refine_gaussians
from edit3r_refiners.simplify import simplify
from edit3r_refiners.simplify.budget import Budget, passes
from jaxtyping import Float
from torch import Tensor

from edit3r.config import PartChoice
from edit3r.errors import InputError
from edit3r.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.mask_from_prompt import masks_from_prompt
from edit3r.registry import Registry, default_registry
from edit3r.reporting import Report, collecting, note, warn
from edit3r.reuse.memory import Memory
from edit3r.reuse.parts import remembering
from edit3r.reuse.state import SceneState
from edit3r.reuse.touched import reconstruct_touched, touched_region, unedited
from edit3r.stage_checks import blaming, check_edit, check_reconstruction, component_name
from edit3r.types import Cameras, EditRequest, Gaussians, Reconstruction, Views

MIN_VISIBLE_CHANGE = 2 / 255  # mean absolute change under which an edit is reported as having done nothing


@dataclass(frozen=True)
class RunResult:
    """What a run made, in memory."""

    photos: Views  # the views that were used, unedited
    edited: Views  # after the 2D editor and the mask composite
    gaussians: Gaussians  # the edited scene, frame of view 0
    cameras: Cameras  # poses of the input views in that frame
    request: EditRequest
    editor: Editor
    reconstructor: Reconstructor
    report: Report = field(repr=False)
    whole: Gaussians = field(repr=False)  # `gaussians` before they were made fewer or refined
    memory: Memory = field(repr=False)  # what the stages answered, for the next run
    earlier: SceneState | None = field(default=None, repr=False)  # what it continued from


def run(
    views: Views,
    prompt: str = "",
    *,
    editor: str | PartChoice | Editor = "recolor",
    recon: str | PartChoice | Reconstructor = "edit3r",
    segmenter: str | PartChoice | Any | None = None,
    masks: Float[Tensor, "batch view height width"] | None = None,
    edit_views: Literal["all", "first"] = "all",
    seed: int = 0,
    device: str | torch.device | None = None,
    gaussians: Budget = "all",
    max_gaussians: int | None = None,
    refine: int = 0,
    rasterizer: str | PartChoice | Rasterizer = "auto",
    settings: Mapping[str, Mapping[str, Any]] | None = None,
    registry: Registry | None = None,
    report: Report | None = None,
    earlier: SceneState | None = None,
    memory: Memory | None = None,
) -> RunResult:
    """Edit `views` as `prompt` says and reconstruct them in 3D.

    `editor`, `recon` and `segmenter` are names, `PartChoice`s or built objects; `settings` holds settings by kind
    (`{"editor": {...}, "reconstructor": {...}}`) for those given by name. `masks` in [0, 1] say where pixels may
    change: outside (exactly 0) they stay bit-equal whatever the editor does. With `edit_views="first"` only view 0 is
    edited and the reconstructor carries the edit to the others. A reconstructor that edits too (it has a part of kind
    editor) is built with this editor and given the request. A `segmenter` is a part of editors that use one; for
    others, without masks, it finds what the prompt is about and confines the edit there. `gaussians` is how many may
    be left: all, those the scene requires (`"auto"`), or a number; `max_gaussians` bounds that on top; `refine` is the
    most photometric steps after that. Same inputs and seed, same result.

    With masks, Gaussians that show outside of them are those of the unedited photos' reconstruction, bit for bit. With
    `earlier`, the scene of another run, `views` are its edited pictures and the edit is put into that scene: what it
    does not touch stays. What matchers and segmenters answered before is taken from `memory`.
    """
    memory = memory or Memory()
    registry = (registry or default_registry()).turning_parts(remembering(memory))
    settings = settings or {}
    report = report or Report()
    with collecting(report):
        with report.stage("load components"):
            parts = {"segmenter": segmenter} if segmenter is not None else {}
            editor = _built(registry, "editor", editor, settings, parts)
            recon = _built(registry, "reconstructor", recon, settings, {"editor": editor})
            if device is not None:
                views = views.to(device)
                masks = masks.to(device) if masks is not None else None
                if recon.network is not None:
                    recon.network.to(device)
        views, masks = _views_for(recon, views, masks)
        photos = views if earlier is None else earlier.photos.to(views.images.device)
        request = EditRequest(prompt, seed, masks)
        if masks is None and segmenter is not None and not takes_part(editor, "segmenter"):
            with report.stage("find what to edit"), torch.no_grad():
                found_by = remembering(memory)(_built(registry, "segmenter", segmenter, settings, {}))
                request = replace(request, masks=masks_from_prompt(prompt, views, found_by))
        with report.stage(f"edit ({component_name(editor)})"), torch.no_grad():
            edited = _edit(editor, views, request, edit_views)
        region = touched_region(views, edited, request, views.count if edit_views == "all" else 1, earlier is not None)
        if earlier is None and takes_part(recon, "editor"):  # it has no answer for photos that are not to be edited
            region = None
        budgets = passes(gaussians, max_gaussians)
        if budgets or refine or region is not None:
            rasterizer = _built(registry, "rasterizer", rasterizer, settings, {})
        with report.stage(f"reconstruct ({component_name(recon)})"), torch.no_grad():
            ask = partial(_reconstruct, recon, photos, request)
            if region is None:
                reconstruction = ask(edited)
            else:
                before = earlier.scene if earlier is not None else unedited(ask, recon, photos, memory)
                before = before.to(views.images.device)
                before = replace(before, cameras=_cameras(before, photos))
                reconstruction = reconstruct_touched(ask, edited, region, before, rasterizer)
            cameras, whole = _cameras(reconstruction, edited), reconstruction.gaussians
            scene = whole
        if budgets:
            with report.stage("simplify"):
                for most in budgets:
                    scene = simplify(scene, cameras, rasterizer, most).gaussians
        if refine:
            with report.stage("refine"):
                # Photos that were not edited would pull the edit back out.
                shown = range(edited.count if edit_views == "all" else 1)
                images = edited.select(shown).images
                refined = refine_gaussians(scene, cameras.select(shown), images, rasterizer, refine)
                scene = refined.gaussians
                note("refine", refined.facts)
    return RunResult(photos, edited, scene, cameras, request, editor, recon, report, whole, memory, earlier)


def _reconstruct(recon: Reconstructor, photos: Views, request: EditRequest, views: Views) -> Reconstruction:
    """The reconstructor's answer, held to its contract; one that edits too is given the request."""
    asked = {"request": request} if takes_part(recon, "editor") else {}
    with blaming(recon):
        reconstruction = recon(views, source=photos, **asked)
    check_reconstruction(recon, views, reconstruction)
    return reconstruction


def _built(registry: Registry, kind: str, choice: Any, settings: Mapping, parts: Mapping[str, Any]) -> Any:
    """The component itself, built from a name or choice where needed."""
    if not isinstance(choice, str | PartChoice):
        return choice
    choice = PartChoice.model_validate(choice) if isinstance(choice, str) else choice
    return registry.build(kind, choice.name, parts, **{**choice.settings, **settings.get(kind, {})})


def takes_part(component: Any, kind: str) -> bool:
    """Whether a built component was declared with a part of that kind."""
    offer = getattr(component, "offer", None)
    return offer is not None and kind in offer.component.parts


def _views_for(recon: Reconstructor, views: Views, masks: Tensor | None) -> tuple[Views, Tensor | None]:
    """Check the view count against what the reconstructor declares; above its maximum take evenly spaced ones."""
    if masks is not None and masks.shape != (*views.images.shape[:2], *views.image_size):
        raise InputError(
            f"masks: expected one per view at the views' size {[*views.images.shape[:2], *views.image_size]}, "
            f"got {list(masks.shape)}."
        )
    if views.count < recon.min_views:
        raise InputError(
            f"{component_name(recon)} needs at least {recon.min_views} photos of the same scene, got {views.count}; "
            f"add photos taken from other places."
        )
    if recon.max_views is None or views.count <= recon.max_views:
        return views, masks
    chosen = torch.linspace(0, views.count - 1, recon.max_views).round().long().tolist()
    warn(f"{component_name(recon)} takes at most {recon.max_views} views; of {views.count} these are used: {chosen}.")
    return views.select(chosen), masks[:, chosen] if masks is not None else None


def _edit(editor: Editor, views: Views, request: EditRequest, edit_views: str) -> Views:
    """Edit all views or the first, hold the editor to its contract, and confine the change to the masks."""
    count = views.count if edit_views == "all" else 1
    chosen = views.select(range(count))
    asked = replace(request, masks=request.masks[:, :count] if request.masks is not None else None)
    with blaming(editor):
        answer = editor.edit(chosen, asked)
    check_edit(editor, chosen, answer)
    if asked.masks is not None:
        spilled = ((answer.images - chosen.images).abs().mean(2) * (asked.masks == 0)).sum()
        outside = (asked.masks == 0).sum().clamp(min=1)
        note("edit.change_outside_mask_before_composite", float(spilled / outside))
        answer = replace(answer, images=composite(chosen.images, answer.images, asked.masks))
    change = (answer.images - chosen.images).abs()
    note("edit.mean_change_per_view", [round(float(c), 5) for c in change.mean((0, 2, 3, 4))])
    if request.prompt and float(change.mean()) < MIN_VISIBLE_CHANGE:
        warn(f"the edit changed the photos very little (mean {255 * float(change.mean()):.1f} of 255).")
    images = torch.cat((answer.images, views.images[:, count:]), dim=1)
    return replace(views, images=images)


def composite(
    original: Float[Tensor, "batch view 3 height width"],
    edited: Float[Tensor, "batch view 3 height width"],
    masks: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 3 height width"]:
    """Blend by mask; bit-equal to `original` where the mask is 0 and to `edited` where it is 1."""
    weight = masks[:, :, None]
    blended = original + weight * (edited - original)
    return torch.where(weight <= 0, original, torch.where(weight >= 1, edited, blended))


def _cameras(reconstruction: Reconstruction, views: Views) -> Cameras:
    """The input views' poses: the reconstructor's own, else found by PnP on its Gaussians."""
    if reconstruction.cameras is not None:
        return reconstruction.cameras
    from edit3r.geometry.pose import estimate_cameras

    note("cameras", "PnP on the predicted Gaussian centres")
    return estimate_cameras(reconstruction.gaussians, views)
