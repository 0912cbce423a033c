"""One run from photos to Gaussians: the loop over the steps, and its result."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import torch
from PIL import Image

from edit3r.cache import Cache, using
from edit3r.contract.interfaces import Editor, Rasterizer, Reconstructor
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Rendering, Views
from edit3r.pipeline.checks import require_device
from edit3r.pipeline.config import RunConfig, check_components
from edit3r.pipeline.earlier import EarlierRun
from edit3r.pipeline.edit_verdict import EditVerdict
from edit3r.pipeline.job import RunJob
from edit3r.pipeline.parts import Parts, with_known_poses
from edit3r.pipeline.quality import note_quality
from edit3r.pipeline.scene import Scene
from edit3r.pipeline.steps.edit import edit
from edit3r.pipeline.steps.judge import judge
from edit3r.pipeline.steps.locate import locate
from edit3r.pipeline.steps.read import read
from edit3r.pipeline.steps.reconstruct import reconstruct
from edit3r.pipeline.steps.refine import refine
from edit3r.pipeline.steps.select import load, select
from edit3r.pipeline.verdict import Verdict
from edit3r.plugins.registry import Registry, default_registry
from edit3r.reporting import Report, collecting

Step = Callable[[Scene, Parts], Scene]
STEPS: tuple[Step, ...] = (locate, select, edit, reconstruct, refine, judge)
"""What follows `read`."""
STEPS_OF_PREVIEW: tuple[Step, ...] = (select, edit)
"""Here geometry is looked for only where something is selected by it."""


@dataclass(frozen=True, repr=False)
class RunResult:
    """What a run made, in memory. In a notebook it shows the sheet and the viewer."""

    scene: Scene = field(repr=False)
    parts: Parts
    report: Report
    cache: Cache  # answers that a further run on the same photos need not compute again

    @property
    def config(self) -> RunConfig:
        return self.parts.config

    @property
    def photos(self) -> Views:
        """The views that were used and placed, unedited."""
        return self.scene.photos

    @property
    def edited(self) -> Views:
        """The views after the 2D editor and the composite with the masks."""
        return self.scene.edited

    @property
    def gaussians(self) -> Gaussians:
        """The edited scene, in the frame of view 0."""
        return self.scene.gaussians

    @property
    def cameras(self) -> Cameras:
        """Poses of the input views in that frame."""
        return self.scene.cameras

    @property
    def rendered(self) -> Rendering:
        """The scene from the input views."""
        return self.scene.rendered

    @property
    def verdict(self) -> Verdict:
        """How well the scene shows the edited images."""
        return self.scene.verdict

    @property
    def edit_verdict(self) -> EditVerdict | None:
        """How surely the edit is what was asked for; None where none was."""
        return self.scene.edit_verdict

    @property
    def editor(self) -> Editor:
        return self.parts.editor

    @property
    def reconstructor(self) -> Reconstructor:
        return self.parts.reconstructor

    @property
    def rasterizer(self) -> Rasterizer:
        return self.parts.rasterizer

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write what `edit3r run` leaves into `folder`, which appears whole or not at all."""
        from edit3r.io.atomic import atomic_folder
        from edit3r.pipeline import write

        with atomic_folder(folder, overwrite) as root:
            write.write(root, self)
        return Path(folder)

    def as_earlier(self) -> EarlierRun:
        """This run as what a further edit starts from."""
        choice = self.config.reconstructor
        return EarlierRun(
            photos=self.photos,
            edited=self.edited,
            scene=Reconstruction(self.gaussians, self.cameras),
            prompts=self.scene.prompts,
            records=self.scene.records,
            reconstructor={"name": choice.name, **choice.settings},
            frames=self.config.frames,
            things=self.scene.things,
        )

    def view(self) -> Path:
        """Open the scene in the browser; returns the page, a temporary file."""
        from edit3r.pipeline import write

        return write.open_viewer(self)

    def compare(self, other: "RunResult") -> Image.Image:
        """A sheet of the photos, this scene and an `other` of the same photos.

        Raises InputError for a result of other photos.
        """
        from edit3r.pipeline import write

        return write.comparison(self, other)

    def __repr__(self) -> str:
        made = f"{self.gaussians.count:,} Gaussians from {self.photos.count} photos"
        return f"RunResult({self.verdict.label}: {made}, {self.config.prompt!r})"

    def _repr_html_(self) -> str:
        from edit3r.pipeline import write

        return write.as_html(self)


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
    scene = read(job, registry)
    parts = Parts(with_known_poses(job, scene.photos, registry), registry, job)
    if reconstruct in steps:
        parts.rasterizer.prepare(torch.device(job.config.device).type)
    scene = load(scene, parts)
    for step in steps:
        scene = step(scene, parts)
    return scene, parts
