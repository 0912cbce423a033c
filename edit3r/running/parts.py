"""The components of one run, each built when it is first asked for."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.interfaces import (
    ChangesShape,
    Editor,
    Matcher,
    Rasterizer,
    Reader,
    Reconstructor,
    Refiner,
    Segmenter,
    Writer,
)
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import say
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit.cache import fingerprint
from edit3r.kit.checks import errors_named_after
from edit3r.loading.registry import Registry
from edit3r.running.config import DEFAULTS, RunConfig
from edit3r.running.editors import EditorTask, tasks_for_editor, tasks_without_editor
from edit3r.running.job import RunJob
from edit3r.running.selecting.geometry import Located, locate


class Parts:
    """What the steps of a run work with: settings, and the components that they name.

    Components that the job brings along are used as they are.
    """

    def __init__(self, config: RunConfig, registry: Registry, job: RunJob) -> None:
        self.config = config
        self.job = job
        self._registry = registry
        self._given = job.components
        self._located: dict[str, Located] = {}

    @property
    def edits_again(self) -> bool:
        """Whether the scene of an earlier run is edited."""
        earlier = self.job.earlier
        return earlier is not None and earlier.scene is not None

    @cached_property
    def reader(self) -> Reader:
        return self._build("reader")

    @cached_property
    def tasks(self) -> tuple[EditorTask, ...]:
        """The editors of the run, each with its part of the prompt."""
        prompt = self.config.prompt
        if self.config.editor is None and "editor" not in self._given:
            return tasks_without_editor(prompt, self.reader, self._registry)
        editor = self._build("editor")
        return tasks_for_editor(editor, prompt, self.reader, self._registry)

    @property
    def editor(self) -> Editor:
        """The first editor, mostly the only one."""
        return self.tasks[0].editor

    @property
    def editor_names(self) -> str:
        return " + ".join(
            dict.fromkeys(component_name(task.editor) for task in self.tasks)
        )

    @property
    def only_task(self) -> EditorTask:
        """The task of a reconstructor that edits by itself; raises PromptError for several."""
        if len(self.tasks) > 1:
            raise PromptError(
                f"reconstructor {component_name(self.reconstructor)!r} edits by itself, with one "
                f"editor, and this sentence needs {self.editor_names}; ask for one thing at a time."
            )
        return self.tasks[0]

    @property
    def changes_shape(self) -> bool:
        """Whether an editor adds or removes things."""
        return any(isinstance(task.editor, ChangesShape) for task in self.tasks)

    @cached_property
    def reconstructor(self) -> Reconstructor:
        reconstructor = self._build("reconstructor", {"editor": self.editor})
        if reconstructor.network is not None and not _places_itself(reconstructor):
            reconstructor.network.to(self.config.device)
        return reconstructor

    @cached_property
    def rasterizer(self) -> Rasterizer:
        return self._build("rasterizer")

    @cached_property
    def refiners(self) -> tuple[Refiner, ...]:
        by_default = not self.reconstructor.fuses_by_itself
        choices = self.config.all_refiners(by_default)
        return tuple(
            self._registry.build_choice("refiner", choice) for choice in choices
        )

    @property
    def matcher(self) -> Matcher | None:
        """The reconstructor's own, where it has one."""
        return getattr(self.reconstructor, "parts", {}).get("matcher")

    def located(self, photos: Views) -> Located:
        """Geometry of unedited photos by the reconstructor's matcher, looked for once."""
        key = fingerprint(photos)
        if key not in self._located:
            self._located[key] = locate(self.matcher, photos)
        return self._located[key]

    @cached_property
    def segmenter(self) -> Segmenter:
        """The one asked for, else the default one."""
        if self._chosen_segmenter is not None:
            return self._build("segmenter")
        return self._registry.build_choice(
            "segmenter", PartChoice(name=DEFAULTS["segmenter"])
        )

    def writer(self, name: str) -> Writer:
        """The writer of that name."""
        return self._registry.build_choice("writer", PartChoice(name=name))

    @property
    def chose_segmenter(self) -> bool:
        """Whether the user asked for a segmenter, so that any editor is confined to the thing."""
        return self._chosen_segmenter is not None

    @property
    def _chosen_segmenter(self) -> Any:
        return self._given.get("segmenter", self.config.segmenter)

    def _build(self, kind: str, parts: Mapping[str, Any] | None = None) -> Any:
        if kind in self._given:
            return self._given[kind]
        return self._registry.build_choice(kind, getattr(self.config, kind), parts)


def _places_itself(reconstructor: Reconstructor) -> bool:
    """Whether a setting of its own, `device`, says where its network computes."""
    settings = getattr(reconstructor, "settings", None)
    return reconstructor.fuses_by_itself and hasattr(settings, "device")


def with_reader(job: RunJob, registry: Registry) -> RunJob:
    """The job with its reader built, the one of all its words."""
    if "reader" in job.components:
        return job
    reader = registry.build_choice("reader", job.config.reader)
    return replace(job, components={**job.components, "reader": reader})


def undone(job: RunJob) -> RunJob:
    """The job without the earlier run's edit, where its sentence begins with "undo".

    Raises PromptError where no earlier run is given.
    """
    rest = job.components["reader"].after_undo(job.config.prompt)
    if rest is None:
        return job
    if job.earlier is None:
        raise PromptError(
            "'undo' takes back an edit of an earlier run, and none is given: add --from its "
            "folder, without photos."
        )
    say("edit.undone", f"taken back: {job.earlier.prompts[-1]}")
    changed: dict[str, Any] = {"prompt": rest}
    if not rest:
        changed["editor"] = PartChoice(name="none")
    return replace(
        job,
        config=job.config.model_copy(update=changed),
        earlier=job.earlier.undone(),
    )


def read_lens(config: RunConfig, registry: Registry, views: Views) -> Lens | None:
    """What bends straight lines in the photos, as the chosen reconstructor's matcher reads it."""
    settings = registry.check("reconstructor", config.reconstructor)
    matcher = getattr(settings, "matcher", None)
    if not isinstance(matcher, PartChoice):
        return None
    built = registry.build_choice("matcher", matcher)
    with errors_named_after(built, views.images):
        return built.lens(views)


def with_known_poses(job: RunJob, photos: Views, registry: Registry) -> RunConfig:
    """The job's settings; given poses are used as they are, unless a matcher was chosen.

    With `refine_poses` they are where bundle adjustment starts.
    """
    config = job.config
    if "reconstructor" in job.components or not (job.cameras or job.refine_poses):
        return config
    chosen = config.reconstructor
    has_matcher = (
        "matcher" in registry.find("reconstructor", chosen.name).component.parts
    )
    usable = photos.c2w is not None and has_matcher and "matcher" not in chosen.settings
    if job.refine_poses and not usable:
        raise InputError(
            "--refine-poses: needs --cameras with the poses of all photos, and no other matcher."
        )
    if not usable:
        return config
    say(
        "poses.source",
        "those that were given" + ("" if job.refine_poses else ", as they are"),
    )
    matcher = DEFAULTS["refined_poses" if job.refine_poses else "known_poses"]
    reconstructor = PartChoice(
        name=chosen.name, settings={**chosen.settings, **matcher}
    )
    return config.model_copy(update={"reconstructor": reconstructor})
