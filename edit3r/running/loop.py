"""One run from photos to Gaussians: the loop over the steps, and its result."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image

from edit3r.contract.devices import require_device
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Reconstruction
from edit3r.kit.cache import Cache, using
from edit3r.kit.files.atomic import atomic_folder
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.config import check_components
from edit3r.running.earlier import EarlierRun
from edit3r.running.job import RunJob
from edit3r.running.parts import Parts, undone, with_reader
from edit3r.running.quality import note_quality
from edit3r.running.record import RunRecord
from edit3r.running.scene import Scene
from edit3r.running.steps.edit import edit
from edit3r.running.steps.judge import judge
from edit3r.running.steps.locate import locate
from edit3r.running.steps.read import read
from edit3r.running.steps.reconstruct import reconstruct
from edit3r.running.steps.refine import refine
from edit3r.running.steps.select import load, select
from edit3r.running.unit import to_given_unit, to_own_unit
from edit3r.running.write import as_html, comparison, open_viewer, write_result

Step = Callable[[Scene, Parts], Scene]
STEPS: tuple[Step, ...] = (locate, select, edit, reconstruct, refine, judge)
"""What follows `read`."""
STEPS_OF_PREVIEW: tuple[Step, ...] = (select, edit)
"""Here geometry is asked for only where something is selected by it."""


@dataclass(frozen=True, repr=False)
class RunResult(RunRecord):
    """What a run made, in memory. In a notebook it shows the sheet and the viewer."""

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write what `edit3r run` leaves into `folder`, which appears whole or not at all."""
        with atomic_folder(folder, overwrite) as root:
            write_result(root, self)
        return Path(folder)

    def as_earlier(self) -> EarlierRun:
        """This run as what a further edit starts from."""
        choice, matcher = self.config.reconstructor, self.config.matcher
        return EarlierRun(
            photos=self.photos,
            edited=self.edited,
            scene=Reconstruction(self.gaussians, self.cameras),
            prompts=self.scene.prompts,
            records=self.scene.records,
            reconstructor={"name": choice.name, **choice.settings},
            matcher={"name": matcher.name, **matcher.settings},
            frames=self.config.frames,
            things=self.scene.things,
        )

    def view(self) -> Path:
        """Open the scene in the browser; returns the page, a temporary file."""
        return open_viewer(self)

    def compare(self, other: "RunResult") -> Image.Image:
        """A sheet of the photos, this scene and an `other` of the same photos.

        Raises InputError for a result of other photos.
        """
        return comparison(self, other)

    def __repr__(self) -> str:
        made = f"{self.gaussians.count:,} Gaussians from {self.photos.count} photos"
        return f"RunResult({self.verdict.label}: {made}, {self.config.prompt!r})"

    def _repr_html_(self) -> str:
        return as_html(self)


def run(
    job: RunJob, registry: Registry | None = None, report: Report | None = None
) -> RunResult:
    """Do what the job asks for. The same job and seed give the same result.

    Where a mask is 0, pixels stay bit-equal, whatever the editor does. Raises InputError for photos
    or masks that cannot be used, SettingsError and UnknownComponentError for wrong settings before
    any photo is read, and PluginError for a component that breaks its contract.
    """
    report = report or Report()
    cache = job.cache or Cache()
    with collecting(report), using(cache):
        scene, parts = _take(job, registry or default_registry(), STEPS)
    return RunResult(scene, parts, report, cache)


def preview(
    job: RunJob,
    registry: Registry | None = None,
    report: Report | None = None,
    *,
    edits: bool = True,
) -> Scene:
    """What is selected and, with `edits`, how it is edited: the first steps of `run`."""
    steps = STEPS_OF_PREVIEW if edits else STEPS_OF_PREVIEW[:1]
    with collecting(report or Report()), using(job.cache or Cache()):
        scene, _ = _take(job, registry or default_registry(), steps)
    return scene


def _take(
    job: RunJob, registry: Registry, steps: tuple[Step, ...]
) -> tuple[Scene, Parts]:
    """Read the job's photos and take the steps, in order."""
    require_device(job.config.device)
    check_components(job.config, registry, job.components)
    note_quality(job.config)
    job = undone(with_reader(job, registry))
    parts = Parts(job.config, registry, job)
    scene, factor = to_own_unit(read(job, parts.lens))
    parts.settle_matcher(scene.photos)
    if reconstruct in steps:
        parts.rasterizer.prepare(torch.device(job.config.device).type)
    scene = load(scene, parts)
    for step in steps:
        scene = step(scene, parts)
    return to_given_unit(scene, factor, job.refine_poses), parts
