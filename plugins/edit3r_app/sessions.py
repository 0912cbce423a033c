"""Scenes whose photos were read once, each a session: views, geometry, and what the segmenter read.

They are read in the background, in the warm process of the server.
"""

import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch

from edit3r import Registry
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.contract.interfaces import Selection
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit.cache import Cache, using
from edit3r.kit.files.atomic import atomic_folder
from edit3r.kit.photos.images import load_photos
from edit3r.kit.scenes.scene_views import SceneGeometry
from edit3r.running import (
    CACHE,
    DEFAULTS,
    EarlierRun,
    GeometryAnswer,
    RunConfig,
    RunFolder,
    RunJob,
    SceneInput,
    default_matcher,
    geometry_answer,
    make_scene_input,
)
from edit3r_app.jobs import JobsFolder
from edit3r_app.uploads import looked_at

# The numbers of this block: no figures kept.
USUAL_PACE = 2.0
"""[s] that the geometry of one photo takes, as long as this machine has not shown its own."""
LOOKED_FIRST = 8.0
"""[s] that a finished scene has this machine for itself, as long as nobody points."""
MAX_READ_AHEAD = 8
"""Photos that the segmenter reads before anybody looks at them."""
SEGMENTER = PartChoice(name=DEFAULTS["segmenter"])


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


@dataclass(frozen=True)
class PhotosProgress:
    """What of a scene's photos is read already, beside the user's looking."""

    photos: bool = False  # a click is answered at once
    geometry: bool = False  # poses and depths are known, or cannot be
    left: float = 0.0  # of the geometry, about [s]
    trouble: str = ""  # why the photos make no good scene, as soon as it is known
    placed: bool = True  # False: they make none at all


@dataclass(frozen=True, eq=False)
class Session:
    """A state of a scene, read once."""

    views: Views  # its photos, edited where it is a run
    cache: Cache
    began: float  # when they began to be read [seconds since 1970]
    earlier: EarlierRun | None  # the run, without its scene; None of photos
    scene: SceneInput | None = None  # the given one of which these are pictures
    geometry: "Future[GeometryAnswer]" = field(default_factory=Future)
    read: dict[int, "Future[None]"] = field(default_factory=dict)
    """By photo: that the segmenter has read it."""
    shown: set[int] = field(default_factory=set)  # photos that somebody looked at
    asked: threading.Event = field(default_factory=threading.Event)
    """That somebody said something, and nothing more is read ahead."""

    def place(self, name: str) -> int:
        """Of a photo among the views; raises InputError where there is none of that name."""
        if name not in self.views.names:
            raise InputError(f"{name[:60]!r}: no photo of that name.")
        return self.views.names.index(name)

    def job(
        self,
        config: RunConfig,
        marks: Selection | None,
        views: list[int] | None = None,
    ) -> RunJob:
        """The run of a draft: on photos, or on from what an earlier run left; of some views."""
        if self.scene is not None and views is None:
            return RunJob(config, scene=self.scene, masks=marks, cache=self.cache)
        if self.earlier is None:
            photos = self.views if views is None else self.views.select(views)
            return RunJob(config, photos, masks=marks, cache=self.cache)
        earlier = self.earlier
        if views is not None:
            earlier = replace(earlier, inputs=earlier.inputs.select(views))
        return RunJob(config, masks=marks, earlier=earlier, cache=self.cache)

    def progress(self, pace: float) -> PhotosProgress:
        """How far it is read; `pace` [s] is what the geometry of a photo takes."""
        views = tuple(self.shown or self.read)
        seen = [self.read.get(view) for view in views]
        photos = bool(seen) and all(one is not None and one.done() for one in seen)
        trouble, placed = self._trouble()
        left = self.left(pace)
        return PhotosProgress(photos, self.geometry.done(), left, trouble, placed)

    def left(self, pace: float) -> float:
        """Until its geometry is known, about [s]."""
        spent = time.time() - self.began
        left = max(1.0, pace * self.views.count - spent)
        return 0.0 if self.geometry.done() else left

    def _trouble(self) -> tuple[str, bool]:
        """What is to be said of photos that make no good scene, and whether they make any."""
        if not self.geometry.done() or self.views.count < 2:
            return "", True
        if self.geometry.exception():
            return str(self.geometry.exception()), False
        answer = self.geometry.result()
        if answer.geometry is None:
            return answer.problem, False
        if answer.problem:
            return answer.problem, True
        placed = zip(self.views.names, answer.geometry.registered[0])
        apart = [name for name, is_in in placed if not is_in]
        if not apart:
            return "", True
        return f"{' and '.join(apart)}: shows too little of what the others show", True


class Sessions:
    """The last four sessions of a folder; others are read anew."""

    def __init__(self, folder: JobsFolder, registry: Registry, size: int) -> None:
        self.folder = folder
        self.registry = registry
        self.size = size  # of the photos [pixels]
        self.background = ThreadPoolExecutor(6)
        self._ahead = ThreadPoolExecutor(6)  # waits for what is in the background
        self._opening = threading.RLock()
        self._changing = threading.Lock()  # what a session has read, and its files
        self._is_closed = False
        self._pace = USUAL_PACE
        self._known: set[tuple[str, tuple[str, ...]]] = set()  # what was opened
        self._sessions = lru_cache(maxsize=4)(self._read)

    def begin(self, state: str) -> PhotosProgress:
        """Read a state's photos in the background, from the first call on; say how far it is."""
        if self._opening.acquire(blocking=False):
            self._opening.release()
            if self.is_open(state):
                return self.open(state).progress(self._pace)
            self.do(self.open, state)
        return PhotosProgress(left=self._pace * len(self.folder.photos(state)))

    def do(self, work: Any, *arguments: Any) -> "Future[Any]":
        """Do it in the background; what the user can mend is told with each answer."""
        if self._is_closed:
            raise CancelledError
        future = self.background.submit(work, *arguments)
        future.add_done_callback(_print_unexpected)
        return future

    def is_open(self, state: str) -> bool:
        return (state, tuple(self.folder.photos(state))) in self._known

    def is_located(self, state: str) -> bool:
        """Whether answers know the geometry of the photos; they are others before."""
        if not (self.folder.root / state).is_dir():  # an edit that waits
            return False
        return self.is_open(state) and self.open(state).geometry.done()

    def open(self, state: str) -> Session:
        with self._opening:
            return self._sessions(state, tuple(self.folder.photos(state)))

    def wait_for_geometry(self, session: Session, patience: float) -> None:
        """Wait where it is nearly there [s]."""
        if session.left(self._pace) <= patience:
            wait([session.geometry], patience)

    def scene_of(self, state: str) -> SceneInput | None:
        """The given scene of a state, as its page has it; None where it is of photos."""
        return self.open(state).scene if self.folder.splat(state) else None

    def forget(self, state: str) -> None:
        """Read a state anew where its name comes back."""
        with self._opening:
            self._known = {one for one in self._known if one[0] != state}
            self._sessions.cache_clear()

    def close(self) -> None:
        """Begin nothing more, and let nothing be half-written."""
        with self._changing:
            self._is_closed = True

    def read_photo(self, session: Session, view: int) -> "Future[None]":
        """Let the segmenter read a photo, once; a click on it is answered soon then."""
        with self._changing:
            if view not in session.read:
                session.read[view] = self.do(self._click, session, view)
            return session.read[view]

    def answers(self, state: str) -> Path:
        """Where what was read from a set of photos is kept; changed by nothing but this."""
        return self.folder.beside(state) / CACHE

    def keep(self, state: str) -> Path:
        """Write what was read from a set of photos until now, and return the folder."""
        self._keep(state, self.open(state).cache)
        return self.answers(state)

    def _read(self, state: str, names: tuple[str, ...]) -> Session:
        """Read a state's photos as a run does; `names` says which there are."""
        path = self.folder.path(state)
        began, earlier = time.time(), None
        scene = self._scene(state)
        if scene is not None:
            cache = Cache(self.answers(state))
            photos = views = scene.views.pictures
        elif self.folder.is_run(state):
            folder = RunFolder(path)
            cache, read = Cache(folder.cache), folder.read()
            earlier = replace(read, inputs=replace(read.inputs, before=None))
            photos, views = earlier.inputs.photos, earlier.inputs.start
        else:
            cache = Cache(self.answers(state))
            files = list(self.folder.photos(state).values())
            with as_in_a_run(cache):
                photos = views = load_photos(files, size=self.size).views
        session = Session(views, cache, began, earlier, scene)
        session.geometry.add_done_callback(_print_unexpected)
        if photos is views:  # else the scene is looked at first
            self.read_photo(session, 0)
        ahead = self._ahead.submit(self._read_ahead, session, photos, state)
        ahead.add_done_callback(_print_unexpected)
        self._known.add((state, names))
        return session

    def _read_ahead(self, session: Session, photos: Views, state: str) -> None:
        """After the first photo read where the photos were taken from, and as long as nobody says
        anything the other ones: who points early waits for no more than that needs. `photos` are
        the unedited ones.
        """
        wait(list(session.read.values()))
        try:
            session.geometry.set_result(self._geometry(photos, session))
        except Exception as error:  # told with each answer
            session.geometry.set_exception(error)
        if photos is not session.views:
            session.asked.wait(LOOKED_FIRST)
        for view in range(min(photos.count, MAX_READ_AHEAD)):
            if view == 0 or not session.asked.is_set():
                wait([self.read_photo(session, view)])
        if photos is session.views:
            self._keep(state, session.cache)

    def _click(self, session: Session, view: int) -> None:
        """Click on a photo, so that the segmenter has read it when the user does."""
        with as_in_a_run(session.cache), suppress(Edit3rError):
            segmenter = self.registry.build_choice("segmenter", SEGMENTER)
            segmenter.masks(session.views.images[0, view], [((0.5, 0.5), True)])

    def _keep(self, state: str, cache: Cache) -> None:
        """Keep what was read from a set of photos for the next start of the server."""
        if not cache.computed:
            return
        with self._changing:
            if self._is_closed:
                return
            with atomic_folder(self.answers(state), overwrite=True) as partial:
                cache.save(partial)

    def _scene(self, state: str) -> SceneInput | None:
        """The given scene of a state, read and looked at; None where it is of photos."""
        splat = self.folder.splat(state)
        if splat is None:
            return None
        file, cameras = splat
        rasterizer = self.registry.build_choice("rasterizer", RunConfig().rasterizer)
        known = None if self.folder.is_run(state) else looked_at(file)
        return known or make_scene_input(file, rasterizer, cameras=cameras)

    def _geometry(self, photos: Views, session: Session) -> GeometryAnswer:
        """Poses and depths, as a run with the default reconstructor finds them."""
        began, cache = time.time(), session.cache
        if session.scene is not None:
            return geometry_answer(SceneGeometry(session.scene.views.scene), photos)
        with as_in_a_run(cache):
            answer = geometry_answer(default_matcher(self.registry), photos)
        if "match" in cache.computed:
            self._pace = (time.time() - began) / photos.count
        return answer


def _print_unexpected(done: Future) -> None:
    """Print what nobody expected."""
    with suppress(Edit3rError, CancelledError):
        done.result()


@contextmanager
def as_in_a_run(cache: Cache) -> Iterator[list[str]]:
    """Work as a run does; yields what components tell the user."""
    messages: list[str] = []

    def hear(event: str, text: str, *counts: int) -> None:
        if event in ("say", "warn"):
            messages.append(text)

    with collecting(Report(on_event=hear)), using(cache), torch.no_grad():
        yield messages
