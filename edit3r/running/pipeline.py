"""One run from photos to Gaussians: its steps."""

from collections.abc import Callable

import torch

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import Report, collecting, stage
from edit3r.contract.torch_state import in_usual_torch, require_device
from edit3r.contract.types import Views
from edit3r.kit.cache import Cache, using
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.components import Components
from edit3r.running.config import check_components
from edit3r.running.hiding import hide, require_hidden_wholly
from edit3r.running.job import RunJob, undone, with_reader
from edit3r.running.measuring import measure
from edit3r.running.records import (
    Inputs,
    Located,
    Preview,
    Records,
    SelectedRegions,
)
from edit3r.running.result import RunResult
from edit3r.running.steps.correct_exposure import correct_exposure
from edit3r.running.steps.edit import edit, edit_alone
from edit3r.running.steps.judge import judge
from edit3r.running.steps.locate import locate
from edit3r.running.steps.read import read
from edit3r.running.steps.reconstruct import reconstruct
from edit3r.running.steps.refine import refine
from edit3r.running.steps.select import (
    as_many_as_fit,
    require_answer,
    require_known_words,
    select,
)


@in_usual_torch
def run(
    job: RunJob,
    registry: Registry | None = None,
    report: Report | None = None,
    *,
    on_edited: Callable[[Views], None] | None = None,
) -> RunResult:
    """Do what the job asks for. The same job and seed give the same result.

    `on_edited` is handed the edited photos as soon as they are there, so that they outlive a later
    step that fails.

    Where a mask is 0, pixels stay bit-equal, whatever the editor does. Raises QuestionError where
    words hardly tell which thing is meant (but for `guess`), InputError for photos
    or masks that cannot be used, SettingsError and UnknownComponentError for wrong settings before
    any photo is read, and PluginError for a component that breaks its contract.
    """
    report = report or Report()
    cache = job.cache or Cache()
    with collecting(report), using(cache):
        inputs, components = _begin(job, registry or default_registry())
        components.rasterizer.prepare(torch.device(job.config.device).type)
        inputs = _to_device(inputs, components)
        records = _records(inputs, components, on_edited)
    return RunResult(records, components, report, cache)


def _records(
    inputs: Inputs, components: Components, on_edited: Callable[[Views], None] | None
) -> Records:
    """All steps, one after the other."""
    require_known_words(inputs, components)
    inputs, located = locate(inputs, components)
    selection = select(inputs, located, components)
    require_answer(inputs, selection, components)
    used = as_many_as_fit(inputs.start, components.reconstructor)
    inputs, located = inputs.select(used), located.select(used)
    selection = selection.select(used)
    edited = edit(inputs, selection, components)
    before, after = inputs.start.images, edited.views.images
    if on_edited is not None and not torch.equal(before, after):
        on_edited(edited.views)
    kept = inputs
    if components.hiding:
        kept = hide(inputs, selection, edited, components)
    corrected = correct_exposure(kept, located, selection, edited, components)
    reconstructed = reconstruct(kept, located, corrected, selection, edited, components)
    placed = reconstructed.used
    # The edit is judged by what was there before.
    inputs, kept = inputs.select(placed), kept.select(placed)
    corrected = corrected.select(placed)
    selection, edited = selection.select(placed), edited.select(placed)
    gaussians = refine(corrected, reconstructed, components)
    judged = judge(
        inputs,
        located,
        selection,
        edited,
        corrected,
        reconstructed,
        gaussians,
        components,
    )
    if kept.length is not None or kept.level is not None:
        refined = components.job.refine_poses
        geometry = located.select(placed).to_build_on
        kept = measure(kept, geometry, reconstructed, judged.rendered, refined)
    return Records(
        kept,
        located,
        selection,
        edited,
        corrected,
        reconstructed,
        gaussians,
        judged,
    )


@in_usual_torch
def preview(
    job: RunJob,
    registry: Registry | None = None,
    report: Report | None = None,
    *,
    edits: bool = True,
) -> Preview:
    """What is selected and, with `edits`, how it is edited: some steps of `run`.

    Geometry is asked for only where something is selected by it.
    """
    with collecting(report or Report()), using(job.cache or Cache()):
        inputs, components = _begin(job, registry or default_registry())
        inputs = _to_device(inputs, components)
        selection = select(inputs, Located(), components)
        used = as_many_as_fit(inputs.start, components.reconstructor)
        inputs, selection = inputs.select(used), selection.select(used)
        edited = edit(inputs, selection, components) if edits else None
        if edited is not None and components.hiding:
            inputs = hide(inputs, selection, edited, components)
    return Preview(inputs, selection, edited)


@in_usual_torch
def preview_photo(
    job: RunJob,
    registry: Registry | None = None,
    selection: SelectedRegions | None = None,
) -> Views:
    """The 2D edit of the job's photos, of which one is enough: nothing is said of it.

    `selection` is what was found on these photos; None: it is looked for.
    """
    with collecting(Report()), using(job.cache or Cache()):
        inputs, components = _begin(job, registry or default_registry())
        inputs = inputs.to(components.config.device)
        selection = selection or select(inputs, Located(), components)
        return edit_alone(inputs, selection, components).views


def _begin(job: RunJob, registry: Registry) -> tuple[Inputs, Components]:
    """The job's photos in their own unit, and the components of the run."""
    require_device(job.config.device)
    check_components(job.config, registry, job.components)
    if job.config.quality is not None:
        from edit3r.running.quality import note_quality

        note_quality(job.config)
    job = undone(with_reader(job, registry))
    components = Components(job.config, registry, job)
    # A sentence that nobody can carry out ends the run before photos are read.
    if components.hiding:
        require_hidden_wholly(components)
    inputs = read(job, components.lens, lambda: components.rasterizer)
    if inputs.scene is not None:
        components.start_from(inputs.scene.views.scene)
    components.settle_matcher(inputs.photos)
    return inputs, components


def _to_device(inputs: Inputs, components: Components) -> Inputs:
    """Inputs on the run's device. Raises InputError for fewer photos than are needed."""
    with stage("load components"):
        count, reconstructor = inputs.start.count, components.reconstructor
        if count < reconstructor.min_views:
            raise InputError(
                f"{component_name(reconstructor)} needs at least {reconstructor.min_views} photos "
                f"of the same scene, got {count}; add photos taken from other places."
            )
        return inputs.to(components.config.device)
