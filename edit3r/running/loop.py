"""One run from photos to Gaussians: its steps."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.reporting import Report, collecting
from edit3r.contract.torch_state import in_usual_torch, require_device
from edit3r.contract.types import Views
from edit3r.kit.cache import Cache, using
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.config import check_components
from edit3r.running.job import RunJob
from edit3r.running.parts import Parts, undone, with_reader
from edit3r.running.records import Inputs, Preview, Records, SelectedRegions
from edit3r.running.scale import to_given_scale, to_working_scale
from edit3r.running.steps.edit import edit, edit_alone
from edit3r.running.steps.judge import judge
from edit3r.running.steps.locate import light_of_edit, locate
from edit3r.running.steps.read import read
from edit3r.running.steps.reconstruct import reconstruct
from edit3r.running.steps.refine import refine
from edit3r.running.steps.select import as_many_as_fit, load, require_answer, select
from edit3r.running.write import RunResult


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
        inputs, factor, parts = _begin(job, registry or default_registry())
        parts.rasterizer.prepare(torch.device(job.config.device).type)
        inputs = load(inputs, parts)
        records = _made(inputs, parts, on_edited)
    records = to_given_scale(records, factor, job.refine_poses)
    return RunResult(records, parts, report, cache)


def _made(
    inputs: Inputs, parts: Parts, on_edited: Callable[[Views], None] | None
) -> Records:
    """All steps, one after the other."""
    inputs, located = locate(inputs, parts)
    selection = select(inputs, parts)
    require_answer(inputs, selection, parts)
    used = as_many_as_fit(inputs.start, parts.reconstructor)
    inputs, located = inputs.select(used), located.select(used)
    selection = selection.select(used)
    edited = edit(inputs, selection, parts)
    before, after = inputs.start.images, edited.views.images
    if on_edited is not None and not torch.equal(before, after):
        on_edited(edited.views)
    located = light_of_edit(inputs, located, selection, edited, parts)
    made = reconstruct(inputs, located, selection, edited, parts)
    placed = made.used
    inputs, located = inputs.select(placed), located.select(placed)
    selection, edited = selection.select(placed), edited.select(placed)
    gaussians = refine(located, edited, made, parts)
    judged = judge(inputs, located, selection, edited, made, gaussians, parts)
    return Records(inputs, located, selection, edited, made, gaussians, judged)


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
        inputs, _, parts = _begin(job, registry or default_registry())
        inputs = load(inputs, parts)
        selection = select(inputs, parts)
        used = as_many_as_fit(inputs.start, parts.reconstructor)
        inputs, selection = inputs.select(used), selection.select(used)
        edited = edit(inputs, selection, parts) if edits else None
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
        inputs, _, parts = _begin(job, registry or default_registry())
        inputs = inputs.to(parts.config.device)
        selection = selection or select(inputs, parts)
        return edit_alone(inputs, selection, parts).views


def _begin(
    job: RunJob, registry: Registry
) -> tuple[Inputs, Float[Tensor, "batch"], Parts]:
    """The job's photos in their own unit, its factor, and the components of the run."""
    require_device(job.config.device)
    check_components(job.config, registry, job.components)
    if job.config.quality is not None:
        from edit3r.running.quality import note_quality

        note_quality(job.config)
    job = undone(with_reader(job, registry))
    parts = Parts(job.config, registry, job)
    # A sentence that nobody can carry out ends the run before photos are read.
    _ = parts.tasks
    inputs, factor = to_working_scale(read(job, parts.lens))
    parts.settle_matcher(inputs.photos)
    return inputs, factor, parts
