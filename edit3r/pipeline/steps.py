"""One run from photos to Gaussians.

    views --> editor --> composite with the masks --> reconstructor --> refiners --> Gaussians
      '------------- the unedited views beside --------------'           (a list)

Writing the results to disk is `edit3r.pipeline.write`. The easy call from Python is `edit3r.run`
(`edit3r.api`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.cache import Cache, recall, using
from edit3r.compute.layers import bilinear
from edit3r.config import PartChoice
from edit3r.contract.interfaces import (
    Editor,
    Rasterizer,
    Reconstructor,
    Refiner,
    Segmenter,
)
from edit3r.contract.types import (
    Cameras,
    EditRequest,
    Gaussians,
    Reconstruction,
    Rendering,
    Views,
)
from edit3r.errors import InputError, PromptError
from edit3r.io.framing import Lens
from edit3r.io.images import Photo
from edit3r.pipeline.checks import (
    check_edit,
    check_reconstruction,
    check_refinement,
    component_name,
    errors_named_after,
    require_device,
)
from edit3r.pipeline.config import DEFAULTS, RunConfig
from edit3r.pipeline.earlier import EarlierRun
from edit3r.pipeline.rendering import render_each
from edit3r.pipeline.verdict import Verdict, judge
from edit3r.plugins.registry import Registry, default_registry
from edit3r.reporting import Report, collecting, note, warn
from edit3r.selection.select import Selection, geometry_of, select_masks

MIN_VISIBLE_CHANGE = (
    2 / 255
)  # mean absolute change under which an edit is reported as having done nothing


@dataclass(frozen=True, repr=False)
class RunResult:
    """What a run made, in memory. In a notebook it shows the sheet and the viewer."""

    photos: Views  # the views that were used and placed, unedited
    edited: Views  # after the 2D editor and the mask composite
    gaussians: Gaussians  # the edited scene, frame of view 0
    cameras: Cameras  # poses of the input views in that frame
    request: EditRequest
    editor: Editor
    reconstructor: Reconstructor
    rasterizer: Rasterizer
    rendered: Rendering  # the scene from the input views
    verdict: Verdict  # how well that shows the edited images
    report: Report
    cache: Cache  # answers that a further run on the same photos need not compute again
    config: RunConfig
    prompts: tuple[str, ...] = ()  # the edits so far, those of an earlier run first
    left_out: Views | None = None  # photos that could not be placed
    records: tuple[Photo, ...] = ()  # how files became the views; () where none did
    mask_files: Mapping[str, str] = field(default_factory=dict)  # file: sha256

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write what `edit3r run` leaves into `folder`, which appears whole or not at all, and
        return it.
        """
        from edit3r.io.atomic import atomic_folder
        from edit3r.pipeline import write as results

        with atomic_folder(folder, overwrite) as root:
            results.write(root, self)
        return Path(folder)

    def view(self) -> Path:
        """Open the scene in the browser; returns the page, a temporary file."""
        from edit3r.pipeline import write as results

        return results.open_viewer(self)

    def __repr__(self) -> str:
        made = f"{self.gaussians.count:,} Gaussians from {self.photos.count} photos"
        return f"RunResult({self.verdict.label}: {made}, {self.config.prompt!r})"

    def _repr_html_(self) -> str:
        from edit3r.pipeline import write as results

        return results.as_html(self)


def run(
    views: Views,
    config: RunConfig,
    *,
    masks: Float[Tensor, "batch view height width"] | Selection | None = None,
    components: Mapping[str, Any] | None = None,
    registry: Registry | None = None,
    report: Report | None = None,
    cache: Cache | None = None,
    earlier: EarlierRun | None = None,
) -> RunResult:
    """Edit `views` as `config` says and reconstruct them in 3D. The same inputs and seed give the
    same result.

    `masks` in [0, 1] say where pixels may change: where a mask is 0 they stay bit-equal, whatever
    the editor does. A Selection (clicks, boxes, masks of some views) is turned into them by the
    segmenter. `components` are built objects by kind, used instead of what `config` names.
    `earlier` is a run whose edited views are `views`: the new edit goes into its scene. Raises
    InputError for views or masks that do not fit the reconstructor, PluginError for a broken
    contract.
    """
    with collecting(report := report or Report()), using(cache := cache or Cache()):
        require_device(config.device)
        with report.stage("load components"):
            parts = _Components(
                config, registry or default_registry(), components or {}
            )
            masks = (
                _masks_of(masks, parts, views.to(config.device))
                if isinstance(masks, Selection)
                else masks
            )
            views, masks = _views_for(parts.reconstructor, views, masks, config.device)
        earlier = earlier.to(views.images.device) if earlier is not None else None
        source = views if earlier is None else earlier.photos
        request = _request(parts, views, masks, config)
        with report.stage(f"edit ({component_name(parts.editor)})"), torch.no_grad():
            edited = _edit(parts.editor, views, request, config.edit_views)
        with (
            report.stage(f"reconstruct ({component_name(parts.reconstructor)})"),
            torch.no_grad(),
        ):
            reconstruct = partial(_reconstruct, parts.reconstructor, source, request)
            scene = _reconstruct(
                parts.reconstructor,
                edited if parts.editor.changes_shape else source,
                request,
                edited,
            )
            request = replace(
                request, masks=_masks_of_change(request, views, edited, earlier, config)
            )
            before = _scene_before(request, parts, reconstruct, source, earlier)
        scene = (
            scene
            if before is None
            else replace(scene, cameras=before.cameras.at(scene.cameras.image_size))
        )
        used, lost = _placed_and_not(scene, views.count)
        edited, request = edited.select(used), request.of_views(used)
        request = replace(request, before=None if before is None else before.gaussians)
        shown = (
            edited.select([0])
            if config.edit_views == "first"
            else _as_fused(edited, scene, request.masks)
        )
        gaussians = _refine(scene, parts, shown, request, earlier is not None, report)
        with report.stage("check"), torch.no_grad():
            rendered, verdict = _judged(
                parts, scene, gaussians, edited, [i in used for i in range(views.count)]
            )
    return RunResult(
        photos=source.select(used),
        edited=edited,
        gaussians=gaussians,
        cameras=scene.cameras.at(edited.image_size),
        request=replace(request, before=None),
        editor=parts.editor,
        reconstructor=parts.reconstructor,
        rasterizer=parts.rasterizer,
        rendered=rendered,
        verdict=verdict,
        report=report,
        cache=cache,
        config=config,
        prompts=(*(earlier.prompts if earlier is not None else ()), config.prompt),
        left_out=source.select(lost) if lost else None,
    )


class _Components:
    """The components of one run, built once each; the rasterizer and segmenter only when something
    asks for them.
    """

    def __init__(
        self, config: RunConfig, registry: Registry, given: Mapping[str, Any]
    ) -> None:
        self._config, self._registry, self._given = config, registry, given
        segmenter = given.get("segmenter", config.segmenter)
        self.editor: Editor = self._built(
            "editor", {"segmenter": segmenter} if segmenter is not None else {}
        )
        self.reconstructor: Reconstructor = self._built(
            "reconstructor", {"editor": self.editor}
        )
        self.refiners: tuple[Refiner, ...] = tuple(
            registry.build_choice("refiner", choice) for choice in config.all_refiners()
        )
        if self.reconstructor.network is not None:
            self.reconstructor.network.to(config.device)

    @cached_property
    def rasterizer(self) -> Rasterizer:
        return self._built("rasterizer")

    @property
    def any_segmenter(self) -> Segmenter:
        """The segmenter asked for, else the editor's own, else the usual one."""
        if self._config.segmenter is not None or "segmenter" in self._given:
            return self._segmenter
        own = getattr(self.editor, "parts", {}).get("segmenter")
        return own or self._registry.build_choice(
            "segmenter", PartChoice(name=DEFAULTS["segmenter"]), {}
        )

    @property
    def own_segmenter(self) -> Any | None:
        """The segmenter asked for, where the editor has no use for one; None otherwise."""
        offer = getattr(self.editor, "offer", None)
        used = offer is not None and "segmenter" in offer.component.parts
        return (
            None
            if used
            or (self._config.segmenter is None and "segmenter" not in self._given)
            else self._segmenter
        )

    @property
    def _segmenter(self) -> Any:
        return self._built("segmenter")

    def _built(self, kind: str, parts: Mapping[str, Any] | None = None) -> Any:
        if kind in self._given:
            return self._given[kind]
        choice: PartChoice = getattr(self._config, kind)
        return self._registry.build_choice(kind, choice, parts)


def lens_of(config: RunConfig, registry: Registry, views: Views) -> Lens | None:
    """What bends straight lines in the photos, as the matcher of the chosen reconstructor reads it
    from them.
    """
    matcher = getattr(
        registry.check("reconstructor", config.reconstructor), "matcher", None
    )
    return (
        registry.build_choice("matcher", matcher).lens(views)
        if isinstance(matcher, PartChoice)
        else None
    )


def _masks_of(
    selection: Selection, parts: _Components, views: Views
) -> Float[Tensor, "1 view height width"]:
    """Masks of what a user selected, carried between views by the reconstructor's own matcher where
    it has one.
    """
    carried = len(set(selection.masks)) < views.count
    geometry = (
        geometry_of(getattr(parts.reconstructor, "parts", {}).get("matcher"), views)
        if carried
        else None
    )
    with torch.no_grad():
        selected = select_masks(
            views.images[0], selection, parts.any_segmenter, geometry, views.intrinsics
        )
    return selected.masks.transpose(0, 1)


def _views_for(
    recon: Reconstructor, views: Views, masks: Tensor | None, device: str
) -> tuple[Views, Tensor | None]:
    """Check views and masks against what the reconstructor takes; above its maximum use evenly
    spaced views.
    """
    views, masks = views.to(device), masks.to(device) if masks is not None else None
    if masks is not None and masks.shape != (
        *views.images.shape[:2],
        *views.image_size,
    ):
        raise InputError(
            "masks: expected one per view at the views' size "
            f"{[*views.images.shape[:2], *views.image_size]}, "
            f"got {list(masks.shape)}."
        )
    if views.count < recon.min_views:
        raise InputError(
            f"{component_name(recon)} needs at least {recon.min_views} photos of the same scene, "
            f"got {views.count}; "
            f"add photos taken from other places."
        )
    if recon.max_views is None or views.count <= recon.max_views:
        return views, masks
    chosen = torch.linspace(0, views.count - 1, recon.max_views).round().long().tolist()
    warn(
        f"{component_name(recon)} takes at most {recon.max_views} views; of {views.count} these "
        f"are used: {chosen}."
    )
    return views.select(chosen), masks[:, chosen] if masks is not None else None


def _request(
    parts: _Components, views: Views, masks: Tensor | None, config: RunConfig
) -> EditRequest:
    """The wish as the stages get it; without masks, a segmenter that was asked for finds what the
    prompt is about.
    """
    from edit3r.selection.from_prompt import masks_from_prompt

    grid = config.grid if config.refine else 1.0
    request = EditRequest(config.prompt, config.seed, masks, config.guess, grid)
    segmenter = parts.own_segmenter if masks is None else None
    if segmenter is None:
        if masks is None and parts.editor.needs_masks:
            raise PromptError(
                f"editor {component_name(parts.editor)!r} changes what is masked, and nothing "
                "is: give --mask FILE for "
                "each photo, or --segmenter NAME with a prompt that names the thing."
            )
        return request
    with torch.no_grad():
        return replace(
            request,
            masks=masks_from_prompt(request.prompt, views, segmenter, config.guess),
        )


def _edit(editor: Editor, views: Views, request: EditRequest, edit_views: str) -> Views:
    """Edit all views or the first, hold the editor to its contract, and keep the pixels outside the
    masks.
    """
    count = views.count if edit_views == "all" else 1
    chosen = views.select(range(count))
    asked = replace(
        request, masks=request.masks[:, :count] if request.masks is not None else None
    )
    with errors_named_after(editor):
        answer = editor.edit(chosen, asked)
    check_edit(editor, chosen, answer)
    if asked.masks is not None:
        spilled = (
            (answer.images - chosen.images).abs().mean(2) * (asked.masks == 0)
        ).sum()
        outside = (asked.masks == 0).sum().clamp(min=1)
        note("edit.change_outside_mask_before_composite", float(spilled / outside))
        answer = replace(
            answer, images=composite(chosen.images, answer.images, asked.masks)
        )
    change = (answer.images - chosen.images).abs()
    note(
        "edit.mean_change_per_view",
        [round(float(c), 5) for c in change.mean((0, 2, 3, 4))],
    )
    if request.prompt and float(change.mean()) < MIN_VISIBLE_CHANGE:
        warn(
            f"the edit changed the photos very little (mean {255 * float(change.mean()):.1f} of "
            "255)."
        )
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


def _reconstruct(
    recon: Reconstructor, source: Views, request: EditRequest, views: Views
) -> Reconstruction:
    """The reconstructor's answer, held to its contract, with cameras found by PnP where it predicts
    none.
    """
    with errors_named_after(recon):
        reconstruction = recon(views, source=source, request=request)
    check_reconstruction(recon, views, reconstruction)
    if reconstruction.cameras is None:
        from edit3r.geometry.pose import estimate_cameras

        note("cameras", "PnP on the predicted Gaussian centres")
        reconstruction = replace(
            reconstruction, cameras=estimate_cameras(reconstruction.gaussians, views)
        )
    return _only_placed(reconstruction)


def _as_fused(
    edited: Views,
    scene: Reconstruction,
    masks: Float[Tensor, "batch view height width"] | None,
) -> Views:
    """The placed views as the scene shows them: refiners that follow each view's own edit make them
    disagree again.

    Outside the masks nothing may change, so there the fused edit does not count either.
    """
    if scene.fusion is None:
        return edited
    change = bilinear(scene.fusion.flatten(0, 1), edited.image_size).view_as(
        edited.images
    )
    fused = (edited.images + change).clamp(0, 1)
    return replace(
        edited,
        images=fused if masks is None else composite(edited.images, fused, masks),
    )


def _placed_and_not(scene: Reconstruction, views: int) -> tuple[list[int], list[int]]:
    """Indices of the views that were placed in every scene of the batch, and of the others."""
    placed = [True] * views if scene.placed is None else scene.placed.all(0).tolist()
    return [i for i in range(views) if placed[i]], [
        i for i in range(views) if not placed[i]
    ]


def _only_placed(reconstruction: Reconstruction) -> Reconstruction:
    """The reconstruction without the Gaussians and cameras of views that could not be placed."""
    if reconstruction.placed is None or bool(reconstruction.placed.all()):
        return reconstruction
    used, _ = _placed_and_not(reconstruction, reconstruction.placed.shape[1])
    gaussians, cameras = reconstruction.gaussians, reconstruction.cameras
    measured, fusion = reconstruction.measured, reconstruction.fusion
    place = torch.full(
        (reconstruction.placed.shape[1] + 1,), -1, device=gaussians.means.device
    )  # last: of no view
    place[used] = torch.arange(len(used), device=place.device)
    kept = gaussians.select(
        (place[gaussians.view_index] >= 0) | (gaussians.view_index < 0)
    )
    return replace(
        reconstruction,
        gaussians=replace(kept, view_index=place[kept.view_index]),
        cameras=cameras.select(used),
        measured=measured[:, used] if measured is not None else None,
        fusion=fusion[:, used] if fusion is not None else None,
    )


def _masks_of_change(
    request: EditRequest,
    views: Views,
    edited: Views,
    earlier: EarlierRun | None,
    config: RunConfig,
) -> Float[Tensor, "batch view height width"] | None:
    """Where the scene may change: the request's masks, else, after an earlier run, where the edit
    changed the images.

    Views that were not edited hold nothing back.
    """
    if request.masks is not None or earlier is None:
        return request.masks
    masks = (edited.images != views.images).any(2).to(views.images)
    if config.edit_views == "first":
        masks[:, 1:] = 1
    return masks


def _scene_before(
    request: EditRequest,
    parts: _Components,
    reconstruct: Callable[[Views], Reconstruction],
    source: Views,
    earlier: EarlierRun | None,
) -> Reconstruction | None:
    """The scene as it was before the edit, where a refiner needs it and the edit may not change
    everything.
    """
    needed = (
        any(refiner.needs_before for refiner in parts.refiners)
        and not parts.editor.changes_shape
    )
    if not needed or request.masks is None or bool((request.masks > 0).all()):
        return None
    if earlier is not None:
        return earlier.scene
    if (
        parts.reconstructor.edits_views
    ):  # it has no answer for photos that are not to be edited
        return None
    return recall(
        "before",
        parts.reconstructor,
        (source, request.grid),
        lambda: reconstruct(source),
    )


def _refine(
    scene: Reconstruction,
    parts: _Components,
    shown: Views,
    request: EditRequest,
    again: bool,
    report: Report,
) -> Gaussians:
    """Apply the refiners in order; one that needs the scene before the edit is left out where there
    is none.

    Editing `again`, that scene is an earlier run's and has been refined. In a first run it has not:
    refiners that need it then come first, where both scenes have one Gaussian a pixel and fit
    without gaps, and the others refine all.
    """
    gaussians = scene.gaussians
    for refiner in (
        parts.refiners
        if again
        else sorted(parts.refiners, key=lambda one: not one.needs_before)
    ):
        if refiner.needs_before and request.before is None:
            continue
        with report.stage(component_name(refiner)), errors_named_after(refiner):
            gaussians = refiner(
                gaussians, scene.cameras, shown, request, parts.rasterizer
            )
        check_refinement(refiner, scene.gaussians, gaussians)
        if refiner.needs_before and not again:
            request = replace(request, before=None)
    return gaussians


def _judged(
    parts: _Components,
    scene: Reconstruction,
    gaussians: Gaussians,
    edited: Views,
    placed: list[bool],
) -> tuple[Rendering, Verdict]:
    """The refined scene from its input views, and the verdict."""
    first, rendered = (
        render_each(parts.rasterizer, of, scene.cameras.at(size), "render input views")
        for of, size in (
            (scene.gaussians, scene.cameras.image_size),
            (gaussians, edited.image_size),
        )
    )
    return rendered, judge(edited, first, rendered, placed, scene.measured)
