"""What a draft means for the photos: what is selected, how the sentence is read, and the 2D edit.

Found in the warm process of the server, by the steps that `edit3r run` takes.
"""

import io
import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r import Registry
from edit3r.contract.component import Component
from edit3r.contract.errors import Edit3rError, InputError, PromptError
from edit3r.contract.interfaces import Marks, Reading, Selected, Selection
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.contract.verdicts import EditVerdict, SelectionVerdict
from edit3r.kit.cache import Cache, using
from edit3r.kit.compute.outlines import overlap
from edit3r.kit.contact_sheet import draw_outline, outlined
from edit3r.kit.files.atomic import atomic_folder, atomic_write
from edit3r.kit.photos.images import load_photos, save_image, to_bytes
from edit3r.running import (
    CACHE,
    DEFAULTS,
    Components,
    EarlierRun,
    GeometryAnswer,
    Preview,
    RunConfig,
    RunFolder,
    RunJob,
    default_matcher,
    geometry_answer,
    make_run_config,
    preview,
    preview_photo,
    usual_selector,
)
from edit3r_app.draft import DRAFT, Draft, Mark
from edit3r_app.forms import run_settings
from edit3r_app.jobs import PREVIEW, JobsFolder

# The numbers of this block: no figures kept.
GEOMETRY_PATIENCE = 10.0
"""[s] that the full answer waits for poses and depths where they are nearly there; else masks are
carried by what the photos show, and it is answered anew later. No figure kept.
"""
USUAL_PACE = 2.0
"""[s] that the geometry of one photo takes, as long as this machine has not shown its own.
No figure kept.
"""
LOOKED_FIRST = 8.0
"""[s] that a made scene has this machine for itself, as long as nobody points. No figure kept."""
AGAIN = 0.2
"""[s] after which one who waits asks whether the answer is still wanted. No figure kept."""
MAX_READ_AHEAD = 8
"""Photos that the segmenter reads before anybody looks at them."""
DIMMED = 0.55
"""Brightness of what is not selected. No figure kept."""
DRAWN = 1024
"""Longer side at least, about, of what is drawn over photos [pixels]."""
BLUR = 0.7  # of steps along its border; a line of one pixel stays [pixels]
THUMBNAIL = 240  # [pixels], longer side of the picture of a reading
CANDIDATES = 5  # that are shown of what may be meant
ANOTHER = 0.6  # overlap from which two of them are one
FINE = 0.004  # how far the border of a candidate may be simplified [longer sides]


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
    told: tuple[str, ...] = ()  # choices and warnings
    # of what words found, in [0, 1]; None: it was marked
    confidence: float | None = None
    is_sure: bool = True  # False: the user is asked whether it is this one
    readings: tuple[Reading, ...] = ()  # what else may be meant, the most likely first
    # the run that it asks for, and what it would select; None where something is missing
    job: RunJob | None = None
    found: Preview | None = None
    is_quick: bool = False  # whether its editors answer at once


class KeepingRegistry(Registry):
    """Builds a component once for each choice, and keeps it with its weights."""

    def __init__(self, registry: Registry) -> None:
        super().__init__(registry.plugins)
        self._built: dict[tuple, Any] = {}
        self._building = threading.RLock()

    def build_choice(
        self, kind: str, choice: PartChoice, parts: Mapping[str, Any] | None = None
    ) -> Any:
        key = (kind, choice.model_dump_json(), *(parts or {}).items())
        with self._building:
            if key not in self._built:
                self._built[key] = super().build_choice(kind, choice, parts)
            return self._built[key]

    def forget(self) -> None:
        """Build everything anew from now on."""
        self._built.clear()


@dataclass(frozen=True, eq=False)
class _Opened:
    """A state of a scene, read once."""

    views: Views  # its photos, edited where it is a run
    cache: Cache
    began: float  # when they began to be read [seconds since 1970]
    earlier: EarlierRun | None  # the run, without its scene; None of photos
    geometry: "Future[GeometryAnswer]" = field(default_factory=Future)
    read: dict[int, "Future[None]"] = field(default_factory=dict)
    """By photo: that the segmenter has read it."""
    shown: set[int] = field(default_factory=set)  # photos that somebody looked at
    asked: threading.Event = field(default_factory=threading.Event)
    """That somebody said something, and nothing more is read ahead."""


@dataclass(frozen=True)
class BeingRead:
    """What of a state's photos is read already, beside the user's looking."""

    photos: bool = False  # a click is answered at once
    geometry: bool = False  # poses and depths are known, or cannot be
    left: float = 0.0  # of the geometry, about [s]
    trouble: str = ""  # why the photos make no good scene, as soon as it is known
    placed: bool = True  # False: they make none at all


class Looker:
    """Answers drafts. One call works at a time; geometry is read in the background."""

    def __init__(self, folder: JobsFolder, registry: Registry, size: int) -> None:
        self.folder = folder
        self.registry = KeepingRegistry(registry)
        self.size = size  # of the photos [pixels]
        self._working = threading.RLock()
        # Pointing has a lock of its own: it never waits for an answer in full. The segmenter is
        # the same, so that what it read of the photos is read once.
        self._pointing = threading.RLock()
        self._opening = threading.RLock()
        self._reading = threading.Lock()
        self._background = ThreadPoolExecutor(6)
        self._ahead = ThreadPoolExecutor(6)  # waits for what is in the background
        self._prepared = threading.Event()
        self._pace = USUAL_PACE
        self._known: set[tuple[str, tuple[str, ...]]] = set()  # what was opened
        self._opened = lru_cache(maxsize=4)(self._open)
        self._looks = lru_cache(maxsize=64)(self._look)
        self._points = lru_cache(maxsize=64)(self._point)
        self._edits = lru_cache(maxsize=4)(self._edit)
        self._found = lru_cache(maxsize=16)(self._find)

    def prepare(self) -> None:
        """Load, in the background and once, what pointing needs, before there are photos."""
        if not self._prepared.is_set():
            self._prepared.set()
            self._background.submit(self._load).add_done_callback(_said)

    def _load(self) -> None:
        # A word of which a picture of nothing knows nothing reads no more than it must.
        choice = PartChoice(name=DEFAULTS["segmenter"])
        with collecting(Report()), suppress(Edit3rError):
            segmenter = self.registry.build_choice("segmenter", choice)
            segmenter.segment_text(torch.zeros(3, 48, 64), "sky")

    def begin(self, state: str) -> BeingRead:
        """Read a state's photos in the background, from the first call on; say how far it is."""
        if not self._opening.acquire(blocking=False):
            return BeingRead(left=self._pace * len(self.folder.photos(state)))
        self._opening.release()
        if self._is_open(state):
            opened = self._open_once(state)
            views = tuple(opened.shown or opened.read)
            seen = [opened.read.get(view) for view in views]
            photos = bool(seen) and all(one is not None and one.done() for one in seen)
            trouble, placed = _trouble(opened)
            left = self._left(opened)
            return BeingRead(photos, opened.geometry.done(), left, trouble, placed)
        self._background.submit(self._open_once, state).add_done_callback(_said)
        return BeingRead(left=self._pace * len(self.folder.photos(state)))

    def _left(self, opened: _Opened) -> float:
        """Until its geometry is known, about [s]."""
        spent = time.time() - opened.began
        left = max(1.0, self._pace * opened.views.count - spent)
        return 0.0 if opened.geometry.done() else left

    def _is_open(self, state: str) -> bool:
        return (state, tuple(self.folder.photos(state))) in self._known

    def _open_once(self, state: str) -> _Opened:
        with self._opening:
            return self._opened(state, tuple(self.folder.photos(state)))

    def look(
        self, state: str, draft: Draft, is_wanted: Callable[[], bool] = lambda: True
    ) -> DraftAnswer:
        """`is_wanted` is asked when others were waited for; the answer is empty where it is not."""
        opened = self._open_once(state)
        # What cannot be read needs no photo, and waits for no search.
        if not draft.selects and (problem := self._misread(draft)):
            return DraftAnswer(opened.views, problem=problem)
        if draft.selects:
            opened.asked.set()
            wait(list(opened.read.values()))  # what is being read is not read twice
            if self._left(opened) <= GEOMETRY_PATIENCE:
                wait([opened.geometry], GEOMETRY_PATIENCE)
        while not self._working.acquire(timeout=AGAIN):
            if not is_wanted():
                return DraftAnswer(opened.views)
        try:
            if not is_wanted():
                return DraftAnswer(opened.views)
            located = opened.geometry.done()
            return self._looks(opened, draft.as_json(), located)
        finally:
            self._working.release()

    def _misread(self, draft: Draft) -> str:
        """Why a quick reader cannot read the sentence; empty where it can."""
        with collecting(Report()), suppress(Edit3rError):
            try:
                config = make_run_config(run_settings(draft, self.registry))
                components = Components(config, self.registry, RunJob(config))
                if config.prompt and _is_quick(components.reader.offer.component):
                    _ = components.tasks
            except PromptError as error:
                return str(error)
        return ""

    def is_located(self, state: str) -> bool:
        """Whether answers know the geometry of the photos; they are others before."""
        if not (self.folder.root / state).is_dir():  # an edit that waits
            return False
        return self._is_open(state) and self._open_once(state).geometry.done()

    def renew(self) -> None:
        """Answer anew from now on: other weights are on this machine."""
        with self._working, self._pointing:
            self.registry.forget()
            for kept in (self._looks, self._points, self._edits, self._found):
                kept.cache_clear()

    def forget(self, state: str) -> None:
        """Read a state anew where its name comes back."""
        with self._opening:
            self._known = {one for one in self._known if one[0] != state}
            self._opened.cache_clear()

    def changes(self, state: str, before: Draft, after: Draft) -> bool:
        """Whether two drafts select different things."""
        old = self.look(state, before).masks
        new = self.look(state, after).masks
        if old is None or new is None:
            return old is not new
        return not torch.equal(old, new)

    def photo(self, state: str, name: str, shown: bool = False) -> bytes:
        """JPEG of one photo as the run sees it; `shown`: in full, so that it may be pointed at."""
        opened = self._open_once(state)
        view = _place(opened.views, name)
        if shown:
            opened.shown.add(view)
            self._begin_reading(opened, view)
        return _jpeg(opened.views.images[0, view])

    def overlay(self, state: str, draft: Draft, name: str, line: bool = False) -> bytes:
        """PNG to lie over one photo: what is selected is outlined, and the rest is darker.

        With `line` nothing is darker.
        """
        look = self.look(state, draft)
        view = _place(look.views, name)
        return _over(None if look.masks is None else look.masks[view], line)

    def edited(self, state: str, draft: Draft, name: str, found: bool = False) -> bytes:
        """JPEG of the 2D edit of one photo, at once; a clear pixel where there is none yet.

        `found`: what is selected is known on all photos, and that is edited.
        """
        opened = self._open_once(state)
        view = _place(opened.views, name)
        with suppress(Edit3rError):
            # Who points meanwhile waits for no answer in full.
            look = self.look(state, draft) if found else None
            with self._pointing:
                if look is not None:
                    edit = self._edited_as_found(opened, look, view)
                else:
                    edit = self._edited_on(opened, draft, view)
                if edit is not None:
                    return _jpeg(edit.images[0, 0])
        return _jpeg(torch.zeros(3, 1, 1))

    def _edited_as_found(
        self, opened: _Opened, look: DraftAnswer, view: int
    ) -> Views | None:
        """What is found is no mark: "all but the bear" would take the bear for it."""
        if look.job is None or look.found is None or not look.is_quick:
            return None
        job = _job_on(opened, look.job.config, None, [view])
        return preview_photo(job, self.registry, look.found.selection.select([view]))

    def _edited_on(self, opened: _Opened, draft: Draft, view: int) -> Views | None:
        """By the marks on that photo alone."""
        config = make_run_config(run_settings(draft, self.registry))
        marks = None
        if draft.selects:
            mask = self._marked_on(opened, draft, opened.views.names[view])
            if mask is None:  # it is marked on another photo
                return None
            # outlines are moved already
            marks = Selection(masks={0: mask})
            plain = {"larger": 0, "reading": 1, "grow": 0.0, "invert": False}
            config = config.model_copy(update=plain)
        job = _job_on(opened, config, marks, [view])
        components = Components(config, self.registry, job)
        if not is_quick(components) or (marks is None and _names_things(components)):
            return None  # what is named is looked for once, for the answer in full
        return preview_photo(job, self.registry)

    def pointed(self, state: str, draft: Draft, name: str, line: bool = False) -> bytes:
        """The same by the marks on that photo alone, at once: before the others were asked.

        With `line` nothing is darker.
        """
        opened = self._open_once(state)
        view = _place(opened.views, name)
        opened.asked.set()
        wait([opened.read[view]] if view in opened.read else [])
        return _over(self._marked_on(opened, draft, name), line)

    def _marked_on(self, opened: _Opened, draft: Draft, name: str) -> Tensor | None:
        """What the marks on one photo select there."""
        own = [one for one in draft.marks if getattr(one, "photo", name) == name]
        alone = Draft(own)
        with self._pointing:  # who asks the same meanwhile gets this answer
            return self._points(opened, alone.as_json(), name)

    def _point(self, opened: _Opened, text: str, name: str) -> Tensor | None:
        draft = DRAFT.validate_json(text)
        if not draft.selects:
            return None
        view = _place(opened.views, name)
        alone = opened.views.select([view])
        selection = replace(
            draft.selection(alone),
            grow=draft.outline["grow"],
            inverted=draft.outline["invert"],
        )
        with _working_with(opened.cache), suppress(Edit3rError):
            return usual_selector().select(alone, selection).masks[0, 0]
        return None

    def candidates(self, state: str, name: str) -> tuple[tuple[Mark, Tensor], ...]:
        """What may be meant on one photo: a mark that takes it, and its mask."""
        opened = self._open_once(state)
        return self._found(opened, name)

    def candidate(self, state: str, name: str, number: int) -> bytes:
        """JPEG of one of them."""
        found = self.candidates(state, name)
        if not 0 <= number < len(found):
            raise InputError("there is no such picture.")
        opened = self._open_once(state)
        image = opened.views.images[0, _place(opened.views, name)]
        return _picture(image, found[number][1])

    def _find(self, opened: _Opened, name: str) -> tuple[tuple[Mark, Tensor], ...]:
        image = opened.views.images[0, _place(opened.views, name)]
        choice = PartChoice(name=DEFAULTS["segmenter"])
        with _working_with(opened.cache):
            segmenter = self.registry.build_choice("segmenter", choice)
            proposals = segmenter.propose(image)
        masks: list[Tensor] = []
        for one in proposals:
            if all(
                overlap(one.soft_mask > 0.5, mask > 0.5) < ANOTHER for mask in masks
            ):
                masks.append(one.soft_mask)
        return tuple((_around(mask, name), mask) for mask in masks[:CANDIDATES])

    def reading(self, state: str, draft: Draft, number: int) -> bytes:
        """JPEG of a reading of what is selected, on the photo where it was found."""
        look = self.look(state, draft)
        found = [one for one in look.readings if one.number == number]
        if not found:
            raise InputError("there is no such reading of what is selected.")
        return _picture(look.views.images[0, found[0].view], found[0].mask)

    def edit_verdict(self, look: DraftAnswer) -> EditVerdict | None:
        """What is to be said of the 2D edit; None of slow editors, and where there is no edit."""
        if look.job is None or not look.is_quick:
            return None
        with self._working:
            edit = self._edits(look).edit
        return None if edit is None else edit.verdict

    def _edit(self, look: DraftAnswer) -> Preview:
        assert look.job is not None  # what is quick has one
        return preview(look.job, self.registry)

    def begin_preview(self, look: DraftAnswer, job: str) -> None:
        """Write beside a job, in the background, what is selected and the 2D edit."""
        self._background.submit(self._preview, look, job)

    def _preview(self, look: DraftAnswer, job: str) -> None:
        views = look.views
        folder = self.folder.beside(job) / PREVIEW
        folder.mkdir()
        is_edited = False
        if look.is_quick:  # of slower editors the edit is seen with the result
            with suppress(Edit3rError), self._working:
                made = self._edits(look)
                if made.edit is not None:
                    views, is_edited = made.edit.views, True
                    _keep_answers(made.edit.verdict, made.selection.verdict, folder)
        for view, name in enumerate(views.names):
            image = views.images[0, view]
            if look.masks is not None and not is_edited:
                image = outlined(image, look.masks[view])
            save_image(image, folder / f"{name}.jpg")

    def _open(self, state: str, names: tuple[str, ...]) -> _Opened:
        """Read a state's photos as a run does; `names` says which there are."""
        path = self.folder.path(state)
        began, earlier = time.time(), None
        if self.folder.is_run(state):
            cache = Cache(path / CACHE)
            read = RunFolder(path).read()
            earlier = replace(read, inputs=replace(read.inputs, before=None))
            photos, views = earlier.inputs.photos, earlier.inputs.start
        else:
            cache = Cache(self._answers(state))
            files = list(self.folder.photos(state).values())
            with _working_with(cache):
                photos = views = load_photos(files, size=self.size).views
        opened = _Opened(views, cache, began, earlier)
        opened.geometry.add_done_callback(_said)
        if photos is views:  # else the scene is looked at first
            self._begin_reading(opened, 0)
        ahead = self._ahead.submit(self._read_ahead, opened, photos, state)
        ahead.add_done_callback(_said)
        self._known.add((state, names))
        return opened

    def _read_ahead(self, opened: _Opened, photos: Views, state: str) -> None:
        """After the first photo read where the photos were taken from, and as long as nobody says
        anything the other ones: who points early waits for no more than that needs. `photos` are
        the unedited ones.
        """
        wait(list(opened.read.values()))
        try:
            opened.geometry.set_result(self._geometry(photos, opened.cache))
        except Exception as error:  # told with each answer
            opened.geometry.set_exception(error)
        if photos is not opened.views:
            opened.asked.wait(LOOKED_FIRST)
        for view in range(min(photos.count, MAX_READ_AHEAD)):
            if view == 0 or not opened.asked.is_set():
                wait([self._begin_reading(opened, view)])
        if photos is opened.views:
            self._keep_answers(state, opened.cache)

    def _begin_reading(self, opened: _Opened, view: int) -> "Future[None]":
        """Let the segmenter read a photo, once; a click on it is answered soon then."""
        with self._reading:
            if view not in opened.read:
                opened.read[view] = self._background.submit(self._click, opened, view)
                opened.read[view].add_done_callback(_said)
            return opened.read[view]

    def _click(self, opened: _Opened, view: int) -> None:
        """Click on a photo, so that the segmenter has read it when the user does."""
        choice = PartChoice(name=DEFAULTS["segmenter"])
        middle = Marks(positive=((0.5, 0.5),))
        with _working_with(opened.cache), suppress(Edit3rError):
            segmenter = self.registry.build_choice("segmenter", choice)
            segmenter.segment_marks(opened.views.images[0, view], middle)

    def _answers(self, state: str) -> Path:
        """Where what was read from a set of photos is kept; changed by nothing but this."""
        return self.folder.beside(state) / CACHE

    def keep_answers(self, state: str) -> Path:
        """Write what was read from a set of photos until now, and return the folder."""
        self._keep_answers(state, self._open_once(state).cache)
        return self._answers(state)

    def _keep_answers(self, state: str, cache: Cache) -> None:
        """Keep what was read from a set of photos for the next start of the server."""
        with self._working:
            if cache.computed:
                with atomic_folder(self._answers(state), overwrite=True) as partial:
                    cache.save(partial)

    def _geometry(self, photos: Views, cache: Cache) -> GeometryAnswer:
        """Poses and depths, as a run with the default reconstructor finds them."""
        began = time.time()
        with _working_with(cache):
            found = geometry_answer(default_matcher(self.registry), photos)
        if "match" in cache.computed:
            self._pace = (time.time() - began) / photos.count
        return found

    def _look(self, opened: _Opened, text: str, located: bool) -> DraftAnswer:
        """`located`: whether the geometry is known, so that it is asked anew when it is."""
        draft = DRAFT.validate_json(text)
        look = DraftAnswer(opened.views)
        with _working_with(opened.cache) as told:
            try:
                config = make_run_config(run_settings(draft, self.registry))
                components = Components(config, self.registry, RunJob(config))
                if draft.selects:
                    look = _with_marks(look, draft, opened, components)
                if config.prompt or config.editor is not None:
                    asked = [
                        one for task in components.tasks for one in task.instructions
                    ]
                    said = "; ".join(map(str, asked)) or config.prompt
                    look = replace(
                        look, understood=f"{said} ({components.editor_names})"
                    )
                    look = self._with_regions(look, opened, components)
            except Edit3rError as error:
                asks = isinstance(error, InputError)
                look = replace(look, problem=str(error), asks=asks)
        return replace(look, told=tuple(told))

    def _with_regions(
        self, look: DraftAnswer, opened: _Opened, components: Components
    ) -> DraftAnswer:
        """Where the sentence applies, as a run finds it."""
        marked = None
        if look.marked is not None:
            marked = Selection(masks=dict(enumerate(look.marked)))
        job = _job_on(opened, components.config, marked)
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
            readings=look.readings or _readings(things),
            is_quick=is_quick(components),
        )


def is_quick(components: Components) -> bool:
    """Whether the editors of a run answer at once."""
    return all(_is_quick(task.editor.offer.component) for task in components.tasks)


def _names_things(components: Components) -> bool:
    """Whether the sentence is about things that words must find."""
    asked = [one for task in components.tasks for one in task.instructions]
    return any(one.thing.scope == "named" for one in asked)


def _is_quick(component: Component) -> bool:
    return not (component.weights or component.needs_network)


def _job_on(
    opened: _Opened,
    config: RunConfig,
    marks: Selection | None,
    views: list[int] | None = None,
) -> RunJob:
    """The run of a draft: on photos, or on from what an earlier run left; of some views alone."""
    if opened.earlier is None:
        photos = opened.views if views is None else opened.views.select(views)
        return RunJob(config, photos, masks=marks, cache=opened.cache)
    earlier = opened.earlier
    if views is not None:
        earlier = replace(earlier, inputs=earlier.inputs.select(views))
    return RunJob(config, masks=marks, earlier=earlier, cache=opened.cache)


def _trouble(opened: _Opened) -> tuple[str, bool]:
    """What is to be said of photos that make no good scene, and whether they make any."""
    views = opened.views
    if not opened.geometry.done() or views.count < 2:
        return "", True
    if opened.geometry.exception():
        return str(opened.geometry.exception()), False
    found = opened.geometry.result()
    if found.geometry is None:
        return found.problem, False
    if found.problem:
        return found.problem, True
    placed = zip(views.names, found.geometry.registered[0])
    apart = [name for name, is_in in placed if not is_in]
    if not apart:
        return "", True
    return f"{' and '.join(apart)}: shows too little of what the others show", True


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
    look: DraftAnswer, draft: Draft, opened: _Opened, components: Components
) -> DraftAnswer:
    """What the marks select on every photo."""
    geometry = opened.geometry.result().trusted() if opened.geometry.done() else None
    selector = components.selector
    found = selector.select(look.views, draft.selection(look.views), geometry)
    marked = found.masks[:, 0]
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
        confidence=found.confidence,
        is_sure=found.is_sure,
        readings=found.readings,
    )


def _readings(things: Sequence[Selected]) -> tuple[Reading, ...]:
    """What else words may mean, where they were unsure."""
    return next((one.readings for one in things if one.readings), ())


def _said(done: Future) -> None:
    """Print what nobody expected; what the user can mend is told with each answer."""
    with suppress(Edit3rError, CancelledError):
        done.result()


def _place(views: Views, name: str) -> int:
    """Of a photo among the views; raises InputError where there is none of that name."""
    if name not in views.names:
        raise InputError(f"{name[:60]!r}: no photo of that name.")
    return views.names.index(name)


def _picture(image: Float[Tensor, "3 height width"], mask: Tensor) -> bytes:
    """JPEG of a photo with one thing outlined and the rest darker."""
    dimmed = image * (DIMMED + (1 - DIMMED) * mask)
    return _jpeg(outlined(dimmed, mask), THUMBNAIL)


def _around(mask: Float[Tensor, "height width"], photo: str) -> Mark:
    """A lasso around the largest piece of a mask."""
    shape = (mask > 0.5).numpy(force=True).astype(np.uint8)
    pieces, _ = cv2.findContours(shape, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = max(pieces, key=cv2.contourArea)
    line = cv2.approxPolyDP(largest, FINE * max(mask.shape), True)[:, 0]
    height, width = mask.shape
    places = [(float(x / width), float(y / height)) for x, y in line]
    return Mark("lasso", photo, places)


def _jpeg(image: Float[Tensor, "3 height width"], most: int = 0) -> bytes:
    content = io.BytesIO()
    made = Image.fromarray(to_bytes(image))
    if most:
        made.thumbnail((most, most))
    made.save(content, "JPEG", quality=88)
    return content.getvalue()


def _over(mask: Float[Tensor, "height width"] | None, line: bool = False) -> bytes:
    """PNG that darkens what is not in a mask and outlines what is; clear without one."""
    content = io.BytesIO()
    if mask is None:
        Image.new("LA", (1, 1)).save(content, "PNG")
        return content.getvalue()
    drawn = _enlarged(mask)
    pixels = np.zeros((*drawn.shape, 2), np.uint8)  # grey and opacity
    if not line:
        pixels[..., 1] = np.rint(255 * (1 - DIMMED) * (1 - drawn))
    draw_outline(pixels, drawn > 0.5)
    Image.fromarray(pixels).save(content, "PNG", compress_level=1)
    return content.getvalue()


def _enlarged(mask: Float[Tensor, "height width"]) -> np.ndarray:
    """The mask with smooth borders, large enough for a thin line on a window."""
    small = mask.float().cpu().numpy()
    factor = max(1, round(DRAWN / max(small.shape)))
    if factor == 1:
        return small
    smooth = cv2.GaussianBlur(small, (0, 0), BLUR)
    wanted = tuple(factor * size for size in small.shape[::-1])
    enlarged = cv2.resize(smooth, wanted, interpolation=cv2.INTER_CUBIC)
    return np.clip(factor * (enlarged - 0.5) + 0.5, 0, 1)


@contextmanager
def _working_with(cache: Cache) -> Iterator[list[str]]:
    """Work as a run does; yields what components tell the user."""
    told: list[str] = []

    def hear(event: str, text: str, *counts: int) -> None:
        if event in ("say", "warn"):
            told.append(text)

    with collecting(Report(on_event=hear)), using(cache), torch.no_grad():
        yield told
