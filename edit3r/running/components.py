"""The components of one run, each built when it is first asked for."""

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError, PromptError, SettingsError
from edit3r.contract.interfaces import (
    ChangesShape,
    Critic,
    Editor,
    FindsGeometry,
    Matcher,
    Rasterizer,
    Reader,
    Reconstructor,
    Refiner,
    Segmenter,
    Selector,
    StartsFromScene,
    Writer,
)
from edit3r.contract.lens import Lens
from edit3r.contract.reporting import say
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import GivenScene, Views
from edit3r.kit import asking
from edit3r.kit.checks import errors_named_after
from edit3r.kit.rendering import OverBackground
from edit3r.kit.scenes.scene_views import SceneGeometry
from edit3r.loading.registry import Registry
from edit3r.running.config import DEFAULTS, RunConfig
from edit3r.running.editors import EditorTask, tasks_for_editor, tasks_without_editor
from edit3r.running.geometry import Source, uses_geometry
from edit3r.running.job import RunJob


class Components:
    """What the steps of a run work with: settings, and the components that they name.

    Components that the job brings along are used as they are; refiners and writers are always
    built. Once the photos are read, `start_from` (a given scene) and `settle_matcher` (given poses)
    replace some.
    """

    def __init__(self, config: RunConfig, registry: Registry, job: RunJob) -> None:
        self.config = config
        self.job = job
        self._registry = registry
        self._given = job.components
        self._scene: GivenScene | None = None
        self._geometry_source: Source | None = None

    @property
    def edits_again(self) -> bool:
        """Whether the scene of an earlier run is edited."""
        earlier = self.job.earlier
        return earlier is not None and earlier.inputs.before is not None

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

    @cached_property
    def hiding(self) -> tuple[int, ...]:
        """Which instructions of all tasks hide their thing for good."""
        asked = [(task.editor, one) for task in self.tasks for one in task.instructions]
        return tuple(place for place, pair in enumerate(asked) if asking.hides(*pair))

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
    def whole_task(self) -> EditorTask:
        """The sentence as one task, for a reconstructor that edits by itself.

        Raises PromptError where that takes the run's editor, and the sentence needs several.
        """
        first, *more = self.tasks
        if more and self._takes_an_editor:
            raise PromptError(
                f"reconstructor {component_name(self.reconstructor)!r} edits by itself, with one "
                f"editor, and this sentence needs {self.editor_names}; ask for one thing at a time."
            )
        if not more:
            return first
        every = tuple(one for task in self.tasks for one in task.instructions)
        return replace(first, prompt=self.config.prompt, instructions=every)

    def edited_count(self, views: Views) -> int:
        """How many of the views, from the first, are edited."""
        return views.count if self.config.edit_views == "all" else 1

    @property
    def changes_shape(self) -> bool:
        """Whether an editor adds or removes things."""
        return any(isinstance(task.editor, ChangesShape) for task in self.tasks)

    @cached_property
    def reconstructor(self) -> Reconstructor:
        parts = {"editor": self.editor} if self._takes_an_editor else None
        reconstructor = self._build("reconstructor", parts)
        if reconstructor.network is not None and not _places_itself(reconstructor):
            reconstructor.network.to(self.config.device)
        return reconstructor

    @property
    def _takes_an_editor(self) -> bool:
        """Whether the reconstructor edits by itself, with the run's editor as its part."""
        if "reconstructor" in self._given:
            return False
        name = self.config.reconstructor.name
        return "editor" in self._registry.find("reconstructor", name).component.parts

    def start_from(self, scene: GivenScene) -> None:
        """Let the components that can go on from a given scene do so.

        Raises SettingsError for a reconstructor that cannot.
        """
        assert "selector" not in self.__dict__, "it would not know the scene"
        recon = self.reconstructor
        if not isinstance(recon, StartsFromScene):
            raise SettingsError(
                f"--recon {component_name(recon)}: makes a scene of photos and cannot go on from "
                "one; leave it out."
            )
        self.reconstructor = recon.starting_from(scene)
        self.rasterizer = OverBackground(self.rasterizer, scene.background)
        self._geometry_source = SceneGeometry(scene)
        self._scene = scene

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
    def geometry_source(self) -> Source:
        """Who reads the photos' geometry: the matcher, or a reconstructor that finds it itself."""
        if self._geometry_source is None:
            self._geometry_source = self._find_geometry_source()
        return self._geometry_source

    def _find_geometry_source(self) -> Source:
        reconstructor = self.reconstructor
        if not isinstance(reconstructor, FindsGeometry):
            return self._build("matcher")
        if self._chose_matcher:
            name = component_name(reconstructor)
            raise SettingsError(
                f"matcher: reconstructor {name!r} finds geometry by itself, so no matcher is asked;"
                " leave --matcher out."
            )
        return reconstructor

    @property
    def _chose_matcher(self) -> bool:
        """Whether the user asked for a matcher."""
        return "matcher" in {*self._given, *self.config.set_by_the_user()}

    @property
    def asked_matcher(self) -> Matcher | None:
        """The matcher, where the run asked one."""
        source = self._geometry_source
        return source if isinstance(source, Matcher) else None

    @property
    def uses_geometry(self) -> bool:
        """Whether the scene stands on the run's geometry."""
        return uses_geometry(self.reconstructor)

    def lens(self, photos: Views) -> Lens | None:
        """What bends straight lines in photos whose lens nobody knows, as the matcher tells."""
        source = self.geometry_source if self.uses_geometry else None
        if not isinstance(source, Matcher):
            return None
        with errors_named_after(source, photos.images):
            return source.lens(photos)

    def settle_matcher(self, photos: Views) -> None:
        """Take the matcher of known poses where the job's cameras have them and none was chosen.

        Raises InputError for poses that shall be refined and are not there.
        """
        job = self.job
        usable = (
            photos.c2w is not None and not self._chose_matcher and self.uses_geometry
        )
        if job.refine_poses and not usable:
            raise InputError(
                "--refine-poses: needs --cameras with the poses of all photos, and no other matcher"
                " nor a reconstructor that uses none."
            )
        if not usable or not (job.cameras or job.refine_poses):
            return
        if isinstance(self.reconstructor, FindsGeometry):
            return
        if job.refine_poses:
            say("poses.source", "those that were given")
            choice = DEFAULTS["refined_poses"]
        else:
            say("poses.source", "those that were given, as they are")
            choice = DEFAULTS["known_poses"]
        matcher = PartChoice.model_validate(choice)
        self.config = self.config.model_copy(update={"matcher": matcher})
        self._geometry_source = None  # one that told the lens was the usual one

    @cached_property
    def segmenter(self) -> Segmenter:
        """The one asked for, else the default one."""
        if self._chosen_segmenter is not None:
            return self._build("segmenter")
        return self._registry.build_choice(
            "segmenter", PartChoice(name=DEFAULTS["segmenter"])
        )

    @cached_property
    def selector(self) -> Selector:
        if "selector" in self._given:
            return self._given["selector"]
        choice = self.config.selector
        takes = self._registry.find("selector", choice.name).component.parts
        parts = {"segmenter": self.segmenter} if "segmenter" in takes else None
        selector = self._registry.build_choice("selector", choice, parts)
        if self._scene is not None and isinstance(selector, StartsFromScene):
            return selector.starting_from(self._scene)
        return selector

    @cached_property
    def critic(self) -> Critic:
        return self._build("critic")

    def writer(self, name: str) -> Writer:
        """The writer of that name."""
        return self._registry.build_choice("writer", self.config.writer_choice(name))

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
