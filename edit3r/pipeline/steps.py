"""The steps of a run. Each takes what is known of the scene and returns it with more filled in.

    read --> select --> edit --> reconstruct --> refine --> judge
    photos   masks      edited    Gaussians      Gaussians   verdicts

`edit3r.pipeline.run` is the loop over them. `read` begins, with the job alone; the others get the
components of the run as `Parts`.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.cache import recall
from edit3r.compute.layers import bilinear
from edit3r.contract.interfaces import (
    ComparesWithBefore,
    Editor,
    EditsRegions,
    EditsViews,
    Reconstructor,
    RefineInputs,
    Refiner,
)
from edit3r.contract.types import EditRequest, Gaussians, Reconstruction, Views
from edit3r.contract.wishes import Thing, Wish
from edit3r.errors import InputError
from edit3r.geometry.maps import dilate_softly
from edit3r.geometry.pose import estimate_cameras
from edit3r.io.atomic import sha256_of
from edit3r.io.coverage import USUAL_FRAMES, choose_photos, origin
from edit3r.io.images import LoadedPhotos, find_photos, load_photos
from edit3r.pipeline.checks import (
    check_edit,
    check_reconstruction,
    check_refinement,
    component_name,
    errors_named_after,
)
from edit3r.pipeline.earlier import EarlierRun
from edit3r.pipeline.edit_measures import measure_edit, measure_edit_in_3d
from edit3r.pipeline.edit_verdict import judge_edit
from edit3r.pipeline.editors import EditorTask
from edit3r.pipeline.job import RunJob
from edit3r.pipeline.parts import Parts, read_lens
from edit3r.pipeline.rendering import render_each
from edit3r.pipeline.scene import Scene, known_cameras
from edit3r.pipeline.verdict import judge as judged
from edit3r.plugins.registry import Registry
from edit3r.reporting import note, say, stage, warn
from edit3r.selection.marks import MarkTexts
from edit3r.selection.near_colour import near_colour
from edit3r.selection.regions import RegionFinder
from edit3r.selection.select import Selection, geometry_of

MIN_VISIBLE_CHANGE = (
    2 / 255
)  # mean absolute change; below it an edit is said to have done nothing


# ---- read ----


def read(job: RunJob, registry: Registry) -> Scene:
    """The photos of the job, or of the earlier run that it goes on from, and their marks."""
    with stage("read photos"):
        masks = job.masks
        if job.earlier is not None:
            scene = _read_earlier(job.earlier)
        elif isinstance(job.photos, Views):
            scene = Scene(photos=job.photos, start=job.photos)
        else:
            found, scene = _read_files(job.photos, job, registry)
            if isinstance(masks, MarkTexts):
                used = [record.file for record in scene.records]
                masks = masks.for_photos([origin(path) for path in found], used)
        scene = replace(scene, prompts=(*scene.prompts, job.config.prompt))
        return _with_marks(scene, masks)


def _read_earlier(earlier: EarlierRun) -> Scene:
    return Scene(
        photos=earlier.photos,
        start=earlier.edited,
        records=earlier.records,
        prompts=earlier.prompts,
        things=earlier.things,
        before=earlier.scene,
    )


def _read_files(
    photos: tuple[Path, ...], job: RunJob, registry: Registry
) -> tuple[list[Path], Scene]:
    """All photos that were found, and the scene of those that are used."""
    config = job.config
    found = find_photos(photos, max(USUAL_FRAMES, config.views or 0))
    loaded = load_photos(
        choose_photos(found, config.views),
        fov=config.fov,
        size=config.size,
        cameras=job.cameras if isinstance(job.cameras, Path) else None,
        read_lens=partial(read_lens, config, registry),
    )
    return found, Scene(photos=loaded.views, start=loaded.views, records=loaded.photos)


def _with_marks(scene: Scene, masks: Tensor | Selection | MarkTexts | None) -> Scene:
    """The scene with given masks, or with what is marked on its photos."""
    if masks is None:
        return scene
    if isinstance(masks, Tensor):
        return replace(scene, masks=masks)
    if isinstance(masks, Selection):
        return replace(scene, marked=masks)
    if not scene.records:
        raise InputError("marks in words need photos that were read from files.")
    marked = masks.read(LoadedPhotos(scene.start, scene.records))
    hashes = {file: sha256_of(Path(file)) for file in masks.mask_files}
    return replace(scene, marked=marked, mask_files=hashes)


# ---- select ----


@torch.no_grad()
def select(scene: Scene, parts: Parts) -> Scene:
    """Which views are used, and which of their pixels may change."""
    with stage("load components"):
        scene, reconstructor = scene.to(parts.config.device), parts.reconstructor
        _require_enough(scene.start, reconstructor)
    with stage("select"):
        scene = _widened(_with_regions(scene, parts), parts)
        return _as_many_as_fit(scene, reconstructor)


def _require_enough(views: Views, reconstructor: Reconstructor) -> None:
    if views.count < reconstructor.min_views:
        raise InputError(
            f"{component_name(reconstructor)} needs at least {reconstructor.min_views} photos of "
            f"the same scene, got {views.count}; add photos taken from other places."
        )


def _as_many_as_fit(scene: Scene, reconstructor: Reconstructor) -> Scene:
    """As many views as the reconstructor takes: above its maximum they are evenly spaced."""
    count, most = scene.start.count, reconstructor.max_views
    if most is None or count <= most:
        return scene
    chosen = torch.linspace(0, count - 1, most).round().long().tolist()
    name = component_name(reconstructor)
    warn(f"{name} takes at most {most} views; of {count} these are used: {chosen}.")
    return scene.select(chosen)


def _with_regions(scene: Scene, parts: Parts) -> Scene:
    """The scene with a region for each wish, and their union as masks.

    An editor that takes any sentence is confined only by marks, or where a segmenter was asked for.
    """
    views = scene.start
    wishes = tuple(wish for task in parts.tasks for wish in task.wishes)
    if scene.masks is not None:
        expected = [*views.images.shape[:2], *views.image_size]
        if list(scene.masks.shape) != expected:
            raise InputError(
                f"masks: expected one per view at the views' size {expected}, got "
                f"{list(scene.masks.shape)}."
            )
        own = [_narrowed(scene.masks, views, wish.thing) for wish in wishes]
        return replace(scene, regions=torch.stack(own) if own else None)
    regional = any(isinstance(task.editor, EditsRegions) for task in parts.tasks)
    named = parts.chose_segmenter and any(
        wish.thing.scope == "named" for wish in wishes
    )
    if scene.marked is None and not regional and not named:
        return scene
    found = [
        _finder(views.scene(index), scene, parts).find(wishes or (MARKED,))
        for index in range(len(views.images))
    ]
    regions = torch.stack([one.masks for one in found], dim=1)
    masks = regions.amax(0)
    if not regional and scene.marked is None:  # words are less exact than marks
        masks = dilate_softly((masks > 0.5).to(masks).flatten(0, 1)).view_as(masks)
    return replace(
        scene,
        regions=regions if wishes else None,
        masks=None if bool((masks >= 1).all()) else masks,
        selected=found[0].selected,
        things=found[0].things,
    )


def _widened(scene: Scene, parts: Parts) -> Scene:
    """The scene with what editors have to change around the things, such as shadows."""
    if scene.regions is None or scene.masks is None:
        return scene
    of_tasks = scene.regions.split([len(task.wishes) for task in parts.tasks])
    regions = torch.cat(
        [
            task.editor.widened(own, scene.start.images)
            for task, own in zip(parts.tasks, of_tasks)
        ]
    )
    wide = torch.maximum(scene.masks, regions.amax(0))
    return replace(scene, regions=regions, masks=wide)


def _narrowed(
    masks: Float[Tensor, "batch view height width"], views: Views, thing: Thing
) -> Float[Tensor, "batch view height width"]:
    """Given masks; of "the red parts" only what is red."""
    if thing.part is None:
        return masks
    scenes = zip(masks, views.images)
    return torch.stack(
        [near_colour(mask, images, thing.part) for mask, images in scenes]
    )


MARKED = Wish("other", Thing("marked"))
"""The wish of a sentence that could not be read, or of none."""


def _finder(views: Views, scene: Scene, parts: Parts) -> RegionFinder:
    config = parts.config
    return RegionFinder(
        views,
        segmenter=lambda: parts.segmenter,
        geometry=lambda: geometry_of(parts.matcher, views),
        marked=scene.marked,
        defaults=Selection(
            guess=config.guess,
            larger=config.larger,
            grow=config.grow,
            inverted=config.invert,
        ),
        known=scene.things,
    )


# ---- edit ----


@torch.no_grad()
def edit(scene: Scene, parts: Parts) -> Scene:
    """Edit all views, or the first alone, one editor after the other."""
    config, views = parts.config, scene.start
    with stage(f"edit ({parts.editor_names})"):
        count = views.count if config.edit_views == "all" else 1
        chosen = views.select(range(count))
        edited, done = chosen, 0
        for task in parts.tasks:
            request = _request(
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
    wishes = [wish for task in parts.tasks for wish in task.wishes]
    measures = measure_edit(scene, wishes, views)
    verdict = judge_edit(measures, _surety(scene))
    if verdict.label == "doubtful":
        warn(f"the edit is doubtful: {verdict.reason}.")
    return replace(scene, edit_verdict=verdict)


def _request(task: EditorTask, scene: Scene, seed: int, wishes: range) -> EditRequest:
    """What one editor is asked; its wishes are those at `wishes` of the whole sentence."""
    regions = None
    if scene.regions is not None:
        regions = scene.regions[wishes.start : wishes.stop]
    if task.wishes:
        say("edit.understood", "; ".join(map(str, task.wishes)))
    return EditRequest(task.prompt, seed, scene.masks, task.wishes, regions)


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


def composite(
    original: Float[Tensor, "batch view 3 height width"],
    edited: Float[Tensor, "batch view 3 height width"],
    masks: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 3 height width"]:
    """Blend by mask; bit-equal to `original` where the mask is 0 and to `edited` where it is 1."""
    weight = masks[:, :, None]
    blended = original + weight * (edited - original)
    return torch.where(weight <= 0, original, torch.where(weight >= 1, edited, blended))


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


# ---- reconstruct ----


@torch.no_grad()
def reconstruct(scene: Scene, parts: Parts) -> Scene:
    """Gaussians and cameras of the edited views, and the scene as it was before the edit."""
    with stage(f"reconstruct ({component_name(parts.reconstructor)})"):
        reconstruction = _reconstructed(scene, parts)
        scene = replace(scene, masks=_masks_of_change(scene, parts))
        before = _before(scene, parts)
    if before is not None:
        size = known_cameras(reconstruction).image_size
        cameras = known_cameras(before).at(size)
        reconstruction = replace(reconstruction, cameras=cameras)
    placed = _placed(reconstruction, scene.start.count)
    used = [view for view, there in enumerate(placed) if there]
    lost = [view for view, there in enumerate(placed) if not there]
    return replace(
        scene.select(used),
        before=before,
        reconstruction=reconstruction,
        gaussians=reconstruction.gaussians,
        placed=placed,
        left_out=scene.photos.select(lost) if lost else None,
    )


def _reconstructed(scene: Scene, parts: Parts) -> Reconstruction:
    """The edited views in 3D; their geometry is that of the photos, unless things come or go."""
    recon, edited = parts.reconstructor, scene.edited
    source = edited if parts.changes_shape else scene.photos
    if not isinstance(recon, EditsViews):
        return _checked(
            recon, edited, lambda: recon(edited, source, _grid(parts, edited))
        )
    task = parts.only_task
    request = _request(task, scene, parts.config.seed, range(len(task.wishes)))
    return _checked(
        recon, edited, lambda: recon.edit_and_reconstruct(edited, source, request)
    )


def _grid(parts: Parts, views: Views) -> tuple[int, int]:
    """(height, width) of the grid of Gaussians: coarser than the views where refining follows."""
    refined = parts.config.refine and not parts.reconstructor.fuses_by_itself
    share = parts.config.grid if refined else 1.0
    height, width = views.image_size
    return max(1, round(share * height)), max(1, round(share * width))


def _checked(
    recon: Reconstructor, views: Views, compute: Callable[[], Reconstruction]
) -> Reconstruction:
    """The answer, held to the contract, with cameras by PnP where it predicts none, and without
    what could not be placed.
    """
    with errors_named_after(recon):
        reconstruction = compute()
    check_reconstruction(recon, views, reconstruction)
    if reconstruction.cameras is None:
        note("cameras", "PnP on the predicted Gaussian centres")
        cameras = estimate_cameras(reconstruction.gaussians, views)
        reconstruction = replace(reconstruction, cameras=cameras)
    return _only_placed(reconstruction)


def _placed(reconstruction: Reconstruction, views: int) -> tuple[bool, ...]:
    """For each view whether it was placed in every scene of the batch."""
    if reconstruction.placed is None:
        return (True,) * views
    return tuple(reconstruction.placed.all(0).tolist())


def _only_placed(reconstruction: Reconstruction) -> Reconstruction:
    """The reconstruction without the Gaussians and cameras of views that could not be placed."""
    if reconstruction.placed is None or bool(reconstruction.placed.all()):
        return reconstruction
    count = reconstruction.placed.shape[1]
    placed = _placed(reconstruction, count)
    used = [view for view, there in enumerate(placed) if there]
    gaussians, cameras = reconstruction.gaussians, known_cameras(reconstruction)
    measured, fusion = reconstruction.measured, reconstruction.fusion
    # The new index of each view; the last entry is for Gaussians of no view, whose index is -1.
    new_index = torch.full((count + 1,), -1, device=gaussians.means.device)
    new_index[used] = torch.arange(len(used), device=new_index.device)
    kept = gaussians.select(
        (new_index[gaussians.view_index] >= 0) | (gaussians.view_index < 0)
    )
    return replace(
        reconstruction,
        gaussians=replace(kept, view_index=new_index[kept.view_index]),
        cameras=cameras.select(used),
        measured=measured[:, used] if measured is not None else None,
        fusion=fusion[:, used] if fusion is not None else None,
    )


def _masks_of_change(
    scene: Scene, parts: Parts
) -> Float[Tensor, "batch view height width"] | None:
    """Where the scene may change: the masks, else, after an earlier run, where the images did.

    Views that were not edited hold nothing back.
    """
    if scene.masks is not None or scene.before is None:
        return scene.masks
    changed = (scene.edited.images != scene.start.images).any(2).to(scene.start.images)
    if parts.config.edit_views == "first":
        changed[:, 1:] = 1
    return changed


def _before(scene: Scene, parts: Parts) -> Reconstruction | None:
    """The scene as it was before the edit, where a refiner needs it and some of it must stay."""
    needed = any(isinstance(refiner, ComparesWithBefore) for refiner in parts.refiners)
    if not needed or parts.changes_shape or not scene.confined:
        return None
    if scene.before is not None:  # an earlier run's
        return scene.before
    recon, photos = parts.reconstructor, scene.photos
    if isinstance(
        recon, EditsViews
    ):  # it has no answer for photos that are not to be edited
        return None
    grid = _grid(parts, photos)

    def compute() -> Reconstruction:
        return _checked(recon, photos, lambda: recon(photos, photos, grid))

    return recall("before", recon, (photos, grid), compute)


# ---- refine ----


def refine(scene: Scene, parts: Parts) -> Scene:
    """Apply the refiners.

    Editing again, `before` is an earlier run's scene and has been refined: the refiners follow in
    their order. In a first run it has not: refiners that compare with it come first, where both
    scenes have one Gaussian a pixel and fit without gaps, and the others refine all.
    """
    again = parts.edits_again
    refiners = parts.refiners
    if len(refiners) < len(parts.config.all_refiners()):
        say(
            "refine.left_out",
            "the reconstructor's Gaussians are kept as they are, for they settle disagreeing edits "
            "by themselves; --gaussians and --refine change them nevertheless",
        )
    if not again:
        first = [one for one in refiners if isinstance(one, ComparesWithBefore)]
        others = [one for one in refiners if not isinstance(one, ComparesWithBefore)]
        refiners = (*first, *others)
    gaussians = scene.gaussians
    for refiner in refiners:
        compares = isinstance(refiner, ComparesWithBefore)
        if compares and scene.before is None:
            continue
        gaussians = _refined(refiner, gaussians, scene, parts)
        if compares and not again:
            scene = replace(scene, before=None)
    return replace(scene, gaussians=gaussians)


def _refined(
    refiner: Refiner, gaussians: Gaussians, scene: Scene, parts: Parts
) -> Gaussians:
    first_alone = parts.config.edit_views == "first"
    inputs = RefineInputs(
        cameras=known_cameras(scene.reconstruction),
        views=scene.edited.select([0]) if first_alone else _as_fused(scene),
        rasterizer=parts.rasterizer,
        masks=scene.masks,
        before=None if scene.before is None else scene.before.gaussians,
        seed=parts.config.seed,
    )
    with stage(component_name(refiner)), errors_named_after(refiner):
        answer = refiner(gaussians, inputs)
    check_refinement(refiner, scene.gaussians, answer)
    return answer


def _as_fused(scene: Scene) -> Views:
    """The edited views as the scene shows them: own edits would make them disagree again.

    Outside the masks nothing may change, so there the fused edit does not count either.
    """
    edited, fusion = scene.edited, scene.reconstruction.fusion
    if fusion is None:
        return edited
    change = bilinear(fusion.flatten(0, 1), edited.image_size).view_as(edited.images)
    fused = (edited.images + change).clamp(0, 1)
    if scene.masks is not None:
        fused = composite(edited.images, fused, scene.masks)
    return replace(edited, images=fused)


# ---- judge ----


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
