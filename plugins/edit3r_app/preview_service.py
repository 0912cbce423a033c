"""Previews of a draft: what is selected, how the sentence is read, and the 2D edit.

Found in the warm process of the server, by the steps that `edit3r run` takes: a stage of them is
one object here, which works on one question at a time and keeps its last answers.
"""

import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import wait
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r import Registry
from edit3r.contract.component import Component
from edit3r.contract.errors import Edit3rError, InputError, PromptError
from edit3r.contract.instructions import Instruction
from edit3r.contract.interfaces import Candidate, SceneToWrite, Selected, Selection
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.types import Cameras, Gaussians, Views
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict
from edit3r.kit.contact_sheet import outlined
from edit3r.kit.files.atomic import atomic_write
from edit3r.kit.photos.images import save_image
from edit3r.running import (
    DEFAULTS,
    Components,
    Preview,
    RunConfig,
    RunJob,
    make_run_config,
    preview,
    preview_photo,
    usual_selector,
)
from edit3r_app.downloads import VIEWER
from edit3r_app.draft import DRAFT, Draft, Mark
from edit3r_app.forms import run_settings
from edit3r_app.jobs import PREVIEW, JobsFolder
from edit3r_app.pictures import around, jpeg, over, picture
from edit3r_app.sessions import (
    SEGMENTER,
    KeepingRegistry,
    PhotosProgress,
    Session,
    Sessions,
    as_in_a_run,
)

# The numbers of this block: no figures kept.
GEOMETRY_PATIENCE = 10.0
"""[s] that the full answer waits for poses and depths where they are nearly there; else photos
without marks wait, and it is answered anew later.
"""
AGAIN = 0.2
"""[s] after which one who waits asks whether the answer is still wanted."""


@dataclass(frozen=True, eq=False)
class DraftAnswer:
    """What a draft means for the photos of a set, or for the edited ones of a run."""

    views: Views
    marked: Float[Tensor, "view height width"] | None = None  # what the marks select
    # where the photos may change; None: everywhere, or nothing is said yet
    masks: Float[Tensor, "view height width"] | None = None
    # the sentence as it was read, and the editor that carries it out
    understood: str = ""
    problem: str = ""  # why it cannot be carried out
    asks: bool = False  # a click would help
    messages: tuple[str, ...] = ()  # choices and warnings
    # of what words found, in [0, 1]; None: it was marked
    confidence: float | None = None
    is_sure: bool = True  # False: the user is asked whether it is this one
    # what else may be meant, the most likely first
    candidates: tuple[Candidate, ...] = ()
    # the run that it asks for, and what it would select; None where something is missing
    job: RunJob | None = None
    found: Preview | None = None
    is_quick: bool = False  # whether its editors answer at once


class Stage:
    """Answers questions, one at a time; the last ones are kept.

    Who asks what somebody else asked meanwhile gets the same answer.
    """

    def __init__(
        self, registry: Registry, answer: Callable[..., Any], kept: int
    ) -> None:
        self.registry = registry
        self.working = threading.RLock()
        self._answer = lru_cache(kept)(answer)

    def ask(self, *question: Any) -> Any:
        with self.working:
            return self._answer(*question)

    def forget(self) -> None:
        with self.working:
            self._answer.cache_clear()


class Pointing(Stage):
    """What marks select on one photo, before the others were asked."""

    def __init__(self, registry: Registry) -> None:
        super().__init__(registry, self._select, kept=64)

    def marked(self, session: Session, draft: Draft, name: str) -> Tensor | None:
        """What the marks on one photo select there."""
        own = [one for one in draft.marks if getattr(one, "photo", name) == name]
        return self.ask(session, Draft(own).as_json(), name)

    def _select(self, session: Session, text: str, name: str) -> Tensor | None:
        draft = DRAFT.validate_json(text)
        if not draft.selects:
            return None
        alone = session.views.select([session.place(name)])
        selection = replace(
            draft.selection(alone),
            grow=draft.outline["grow"],
            inverted=draft.outline["invert"],
        )
        with as_in_a_run(session.cache), suppress(Edit3rError):
            return usual_selector().select(alone, selection).masks[0, 0]
        return None


class Suggestions(Stage):
    """What may be meant on one photo: a mark that takes it, and its mask."""

    def __init__(self, registry: Registry) -> None:
        super().__init__(registry, self._find, kept=16)

    def _find(self, session: Session, name: str) -> tuple[tuple[Mark, Tensor], ...]:
        alone = session.views.select([session.place(name)])
        with as_in_a_run(session.cache), suppress(Edit3rError):
            found = usual_selector().select(alone, Selection())
            return tuple((around(one.mask, name), one.mask) for one in found.candidates)
        return ()


class DraftSelection(Stage):
    """What a whole draft selects on all photos, and how its sentence is read."""

    def __init__(self, registry: Registry) -> None:
        super().__init__(registry, self._look, kept=64)

    def misread(self, draft: Draft) -> str:
        """Why a quick reader cannot read the sentence; empty where it can."""
        with collecting(Report()), suppress(Edit3rError):
            try:
                components = self._components(draft)
                reads = _is_quick(components.reader.offer.component)
                if components.config.prompt and reads:
                    _ = components.tasks
            except PromptError as error:
                return str(error)
        return ""

    def look(
        self, session: Session, draft: Draft, is_wanted: Callable[[], bool]
    ) -> DraftAnswer:
        """The answer; an empty one where it is not wanted any more once others were answered."""
        while not self.working.acquire(timeout=AGAIN):
            if not is_wanted():
                return DraftAnswer(session.views)
        try:
            if not is_wanted():
                return DraftAnswer(session.views)
            # once the geometry is known it is asked anew
            return self.ask(session, draft.as_json(), session.geometry.done())
        finally:
            self.working.release()

    def _components(self, draft: Draft, session: Session | None = None) -> Components:
        """Those of a run; in a session of a given scene they go on from that."""
        settings = run_settings(draft, self.registry)
        scene = None if session is None else session.scene
        layers = [] if scene is None else [DEFAULTS["of_scenes"]]
        config = make_run_config(*layers, settings)
        components = Components(config, self.registry, RunJob(config))
        if scene is not None:
            components.start_from(scene.views.scene)
        return components

    def _look(self, session: Session, text: str, located: bool) -> DraftAnswer:
        draft = DRAFT.validate_json(text)
        look = DraftAnswer(session.views)
        with as_in_a_run(session.cache) as messages:
            try:
                components = self._components(draft, session)
                config = components.config
                if draft.selects:
                    look = _with_marks(look, draft, session, components)
                if config.prompt or config.editor is not None:
                    said = _instructions(components)
                    if draft.selects:
                        said = [_confined(one) for one in said]
                    asked = "; ".join(map(str, said))
                    understood = f"{asked or config.prompt} ({components.editor_names})"
                    look = replace(look, understood=understood)
                    look = self._with_regions(look, session, components)
            except Edit3rError as error:
                asks = isinstance(error, InputError)
                look = replace(look, problem=str(error), asks=asks)
        if draft.chose:
            look = replace(look, confidence=None, is_sure=True)
        return replace(look, messages=tuple(messages))

    def _with_regions(
        self, look: DraftAnswer, session: Session, components: Components
    ) -> DraftAnswer:
        """Where the sentence applies, as a run finds it."""
        marked = None
        if look.marked is not None:
            marked = Selection(masks=dict(enumerate(look.marked)))
        job = session.job(components.config, marked)
        found = preview(job, self.registry, edits=False)
        selection, things = found.selection, found.selection.selected
        confidences = [one.confidence for one in things if one.confidence is not None]
        return replace(
            look,
            masks=None if selection.masks is None else selection.masks[0],
            job=job,
            found=found,
            confidence=min(confidences, default=look.confidence),
            is_sure=look.is_sure and all(one.is_sure for one in things),
            candidates=look.candidates or _candidates(things),
            is_quick=_all_quick(components),
        )


class Editing(Stage):
    """The 2D edits of quick editors."""

    def __init__(self, registry: Registry, pointing: Pointing) -> None:
        super().__init__(registry, self._edit, kept=4)
        self._pointing = pointing

    def edit(self, look: DraftAnswer) -> Preview | None:
        """What the editors make of all photos; None of slow ones, and without an edit."""
        return self.ask(look) if look.job is not None and look.is_quick else None

    def _edit(self, look: DraftAnswer) -> Preview:
        assert look.job is not None  # what is quick has one
        return preview(look.job, self.registry)

    def on_photo(
        self, session: Session, draft: Draft, view: int, look: DraftAnswer | None
    ) -> Views | None:
        """The edit of one photo: of what was found on all (`look`), else by the marks on it."""
        if look is not None:
            return self._of_found(session, look, view)
        return self._of_marks(session, draft, view)

    def _of_found(self, session: Session, look: DraftAnswer, view: int) -> Views | None:
        """What is found is no mark: "all but the bear" would take the bear for it."""
        if look.job is None or look.found is None or not look.is_quick:
            return None
        job = session.job(look.job.config, None, [view])
        return preview_photo(job, self.registry, look.found.selection.select([view]))

    def _of_marks(self, session: Session, draft: Draft, view: int) -> Views | None:
        config = make_run_config(run_settings(draft, self.registry))
        marks = None
        if draft.selects:
            name = session.views.names[view]
            mask = self._pointing.marked(session, draft, name)
            if mask is None:  # it is marked on another photo
                return None
            # outlines are moved already
            marks = Selection(masks={0: mask})
            plain = {"larger": 0, "candidate": 1, "grow": 0.0, "invert": False}
            config = config.model_copy(update=plain)
        job = session.job(config, marks, [view])
        components = Components(config, self.registry, job)
        named = any(one.target.scope == "named" for one in _instructions(components))
        if not _all_quick(components) or (marks is None and named):
            return None  # what is named is looked for once, for the answer in full
        return preview_photo(job, self.registry)


class PreviewService:
    """Answers drafts, and draws the answers; photos are read in the background."""

    def __init__(self, folder: JobsFolder, registry: Registry, size: int) -> None:
        self.folder = folder
        self.registry = KeepingRegistry(registry)
        self.size = size  # of the photos [pixels]
        self.sessions = Sessions(folder, self.registry, size)
        # Pointing never waits for an answer in full. The segmenter is the same, so that what it
        # read of the photos is read once.
        self.pointing = Pointing(self.registry)
        self.selecting = DraftSelection(self.registry)
        self.editing = Editing(self.registry, self.pointing)
        self._suggestions = Suggestions(self.registry)
        self._prepared = threading.Event()

    def prepare(self) -> None:
        """Load, in the background and once, what pointing needs, before there are photos."""
        if not self._prepared.is_set():
            self._prepared.set()
            self.sessions.do(self._load)

    def _load(self) -> None:
        # A word of which a picture of nothing knows nothing reads no more than it must.
        with collecting(Report()), suppress(Edit3rError):
            segmenter = self.registry.build_choice("segmenter", SEGMENTER)
            segmenter.words(torch.zeros(3, 48, 64), "sky")
            rasterizer = self.registry.build_choice(
                "rasterizer", RunConfig().rasterizer
            )
            one, eye = torch.ones(1, 1, 4), torch.eye(4).expand(1, 1, 4, 4)
            place, opacity = one[..., :3], one[..., 0]
            dot = Gaussians(place, place, one, opacity, place[:, :, None])
            rasterizer.render(dot, Cameras(eye, eye[..., :3, :3], (8, 8)))

    def begin(self, state: str) -> PhotosProgress:
        """Read a state's photos in the background, from the first call on; say how far it is."""
        return self.sessions.begin(state)

    def renew(self) -> None:
        """Answer anew from now on: other weights are on this machine."""
        self.registry.forget()
        for one in (self.selecting, self.pointing, self.editing, self._suggestions):
            one.forget()

    def look(
        self, state: str, draft: Draft, is_wanted: Callable[[], bool] = lambda: True
    ) -> DraftAnswer:
        """`is_wanted` is asked when others were waited for; the answer is empty where it is not."""
        session = self.sessions.open(state)
        # What cannot be read needs no photo, and waits for no search.
        if not draft.selects and (problem := self.selecting.misread(draft)):
            return DraftAnswer(session.views, problem=problem)
        if draft.selects:
            session.asked.set()
            wait(list(session.read.values()))  # what is being read is not read twice
            self.sessions.wait_for_geometry(session, GEOMETRY_PATIENCE)
        return self.selecting.look(session, draft, is_wanted)

    def changes(self, state: str, before: Draft, after: Draft) -> bool:
        """Whether two drafts select different things."""
        old = self.look(state, before).masks
        new = self.look(state, after).masks
        if old is None or new is None:
            return old is not new
        return not torch.equal(old, new)

    def photo(self, state: str, name: str, shown: bool = False) -> bytes:
        """JPEG of one photo as the run sees it; `shown`: in full, so that it may be pointed at."""
        session = self.sessions.open(state)
        view = session.place(name)
        if shown:
            session.shown.add(view)
            self.sessions.read_photo(session, view)
        return jpeg(session.views.images[0, view])

    def viewer(self, state: str) -> Path:
        """The page of a dropped scene, before anything is made of it."""
        made = self.folder.beside(state) / VIEWER
        scene = self.sessions.open(state).scene
        if scene is None:
            raise InputError(f"{state}: there is no scene yet.")
        if not made.is_file():
            shown, names = scene.views.scene, scene.places.names
            to_write = SceneToWrite(shown.gaussians, shown.cameras, names, title=state)
            with atomic_write(made) as partial:
                self.registry.build("writer", "viewer").write(partial, to_write)
        return made

    def overlay(self, state: str, draft: Draft, name: str, line: bool = False) -> bytes:
        """PNG to lie over one photo: what is selected is outlined, and the rest is darker.

        With `line` nothing is darker.
        """
        view = self.sessions.open(state).place(name)
        masks = self.look(state, draft).masks
        return over(None if masks is None else masks[view], line)

    def pointed(self, state: str, draft: Draft, name: str, line: bool = False) -> bytes:
        """The same by the marks on that photo alone, at once: before the others were asked."""
        session = self.sessions.open(state)
        view = session.place(name)
        session.asked.set()
        wait([session.read[view]] if view in session.read else [])
        return over(self.pointing.marked(session, draft, name), line)

    def edited(self, state: str, draft: Draft, name: str, found: bool = False) -> bytes:
        """JPEG of the 2D edit of one photo, at once; a clear pixel where there is none yet.

        `found`: what is selected is known on all photos, and that is edited.
        """
        session = self.sessions.open(state)
        view = session.place(name)
        with suppress(Edit3rError):
            # Who points meanwhile waits for no answer in full.
            look = self.look(state, draft) if found else None
            with self.pointing.working:
                edit = self.editing.on_photo(session, draft, view, look)
            if edit is not None:
                return jpeg(edit.images[0, 0])
        return jpeg(torch.zeros(3, 1, 1))

    def suggestions(self, state: str, name: str) -> tuple[tuple[Mark, Tensor], ...]:
        """What may be meant on one photo: a mark that takes it, and its mask."""
        return self._suggestions.ask(self.sessions.open(state), name)

    def suggestion(self, state: str, name: str, number: int) -> bytes:
        """JPEG of one of them."""
        found = self.suggestions(state, name)
        if not 0 <= number < len(found):
            raise InputError("there is no such picture.")
        session = self.sessions.open(state)
        image = session.views.images[0, session.place(name)]
        return picture(image, found[number][1])

    def candidate(self, state: str, draft: Draft, number: int) -> bytes:
        """JPEG of a candidate of what is selected, on the photo where it was found."""
        look = self.look(state, draft)
        found = [one for one in look.candidates if one.number == number]
        if not found:
            raise InputError("there is no such candidate of what is selected.")
        return picture(look.views.images[0, found[0].view], found[0].mask)

    def edit_verdict(self, look: DraftAnswer) -> EditVerdict | None:
        """What is to be said of the 2D edit; None of slow editors, and where there is no edit."""
        with self.selecting.working:
            made = self.editing.edit(look)
        return None if made is None or made.edit is None else made.edit.verdict

    def begin_preview(self, look: DraftAnswer, job: str) -> None:
        """Write beside a job, in the background, what is selected and the 2D edit."""
        self.sessions.background.submit(self._preview, look, job)

    def _preview(self, look: DraftAnswer, job: str) -> None:
        views, masks = look.views, look.masks
        folder = self.folder.beside(job) / PREVIEW
        folder.mkdir()
        # of slower editors the edit is seen with the result
        with suppress(Edit3rError), self.selecting.working:
            made = self.editing.edit(look)
            if made is not None and made.edit is not None:
                views, masks = made.edit.views, None
                _keep_answers(made.edit.verdict, made.selection.verdict, folder)
        for view, name in enumerate(views.names):
            image = views.images[0, view]
            shown = image if masks is None else outlined(image, masks[view])
            save_image(shown, folder / f"{name}.jpg")


def _instructions(components: Components) -> list[Any]:
    return [one for task in components.tasks for one in task.instructions]


def _confined(one: Instruction) -> Instruction:
    """What is said of the whole picture is done, beside marks, where they are."""
    is_all = one.target.scope == "whole" and not one.without
    if not is_all:
        return one
    target = replace(one.target, scope="marked", name="what you marked")
    return replace(one, target=target)


def _all_quick(components: Components) -> bool:
    """Whether the editors of a run answer at once."""
    return all(_is_quick(task.editor.offer.component) for task in components.tasks)


def _is_quick(component: Component) -> bool:
    return not (component.weights or component.needs_network)


def _keep_answers(
    edit: EditVerdict | None, selected: SelectionVerdict | None, folder: Path
) -> None:
    """Write the answers on a preview as run.json will hold those on the whole run."""
    answers = {"edit_verdict": edit, "selection_verdict": selected}
    known = {key: asdict(one) for key, one in answers.items() if one is not None}
    if known:
        content = json.dumps(known)
        with atomic_write(folder / "run.json") as partial:
            partial.write_text(content, encoding="utf-8")


def _with_marks(
    look: DraftAnswer, draft: Draft, session: Session, components: Components
) -> DraftAnswer:
    """What the marks select on every photo."""
    geometry = session.geometry.result().trusted() if session.geometry.done() else None
    selector = components.selector
    selected = selector.select(look.views, draft.selection(look.views), geometry)
    marked = selected.masks[:, 0]
    outline = Selection(
        masks=dict(enumerate(marked)),
        grow=components.config.grow,
        inverted=components.config.invert,
    )
    masks = selector.select(look.views, outline).masks[:, 0]
    return replace(
        look,
        marked=marked,
        masks=masks,
        confidence=selected.confidence,
        is_sure=selected.is_sure,
        candidates=selected.candidates,
    )


def _candidates(things: Sequence[Selected]) -> tuple[Candidate, ...]:
    """What else words may mean, where they were unsure."""
    return next((one.candidates for one in things if one.candidates), ())
