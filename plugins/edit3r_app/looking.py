"""What a draft means for the photos: what is selected, how the sentence is read, and the 2D edit.

Found in the warm process of the server, by the steps that `edit3r run` takes.
"""

import io
import json
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from PIL import Image
from torch import Tensor

from edit3r import Registry
from edit3r.contract.errors import Edit3rError, InputError
from edit3r.contract.interfaces import Marks, MatchedGeometry
from edit3r.contract.reporting import Report, collecting
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit.cache import Cache, using
from edit3r.kit.files.atomic import atomic_folder, atomic_write
from edit3r.kit.photos.images import load_photos, save_image, to_bytes
from edit3r.kit.photos.outline import outlined
from edit3r.running import (
    CACHE,
    DEFAULTS,
    EditVerdict,
    Parts,
    RunJob,
    Scene,
    Selection,
    default_matcher,
    geometry_of,
    make_run_config,
    preview,
    read_views_of_run,
    select_masks,
)
from edit3r_app.draft import DRAFT, Draft
from edit3r_app.forms import run_settings
from edit3r_app.jobs import PREVIEW, JobsFolder

GEOMETRY_PATIENCE = 3.0
"""[s] that a mark waits for poses and depths before masks are carried by what the photos show."""
MAX_CLICKED_AHEAD = 8
"""Photos that the segmenter reads before anybody clicks."""
DIMMED = 0.55
"""Brightness of what is not selected."""


@dataclass(frozen=True, eq=False)
class DraftAnswer:
    """What a draft means for the photos of a set, or for the edited ones of a run."""

    views: Views
    marked: Float[Tensor, "view height width"] | None = None  # what the marks select
    # where the photos may change; None: everywhere, or nothing is said yet
    masks: Float[Tensor, "view height width"] | None = None
    understood: str = (
        ""  # the sentence as it was read, and the editor that carries it out
    )
    problem: str = ""  # why it cannot be carried out
    asks: bool = False  # a click, or a guess, would help
    told: tuple[str, ...] = ()  # choices and warnings
    surety: float | None = None  # of what words found, in [0, 1]; None: it was marked
    job: RunJob | None = (
        None  # the run that it asks for; None where something is missing
    )
    is_quick: bool = False  # whether its editors answer at once


class KeepingRegistry(Registry):
    """Builds a component once for each choice, and keeps it with its weights."""

    def __init__(self, registry: Registry) -> None:
        super().__init__(registry.plugins)
        self._built: dict[tuple, Any] = {}

    def build_choice(
        self, kind: str, choice: PartChoice, parts: dict[str, Any] | None = None
    ) -> Any:
        key = (kind, choice.model_dump_json(), *(parts or {}).items())
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
    geometry: "Future[MatchedGeometry | None]"


class Looker:
    """Answers drafts. One call works at a time; geometry is read in the background."""

    def __init__(self, folder: JobsFolder, registry: Registry, size: int) -> None:
        self.folder = folder
        self.registry = KeepingRegistry(registry)
        self.size = size  # of the photos [pixels]
        self._working = threading.RLock()
        self._background = ThreadPoolExecutor(2)
        self._opened = lru_cache(maxsize=4)(self._open)
        self._looks = lru_cache(maxsize=64)(self._look)
        self._edits = lru_cache(maxsize=4)(self._edit)

    def look(self, state: str, draft: Draft) -> DraftAnswer:
        with self._working:
            opened = self._opened(state, tuple(self.folder.photos(state)))
            return self._looks(opened, draft.as_json())

    def renew(self) -> None:
        """Answer anew from now on: other weights are on this machine."""
        with self._working:
            self.registry.forget()
            self._looks.cache_clear()
            self._edits.cache_clear()

    def changes(self, state: str, before: Draft, after: Draft) -> bool:
        """Whether two drafts select different things."""
        old = self.look(state, before).masks
        new = self.look(state, after).masks
        if old is None or new is None:
            return old is not new
        return not torch.equal(old, new)

    def image(self, state: str, draft: Draft, name: str) -> bytes:
        """JPEG of one photo; what is selected is outlined, and the rest is darker."""
        look = self.look(state, draft)
        if name not in look.views.names:
            raise InputError(f"{name[:60]!r}: no photo of that name.")
        view = look.views.names.index(name)
        image = look.views.images[0, view]
        if look.masks is not None:
            mask = look.masks[view]
            image = outlined(image * (DIMMED + (1 - DIMMED) * mask), mask)
        content = io.BytesIO()
        Image.fromarray(to_bytes(image)).save(content, "JPEG", quality=88)
        return content.getvalue()

    def edit_verdict(self, look: DraftAnswer) -> EditVerdict | None:
        """What is to be said of the 2D edit; None of slow editors, and where there is no edit."""
        if look.job is None or not look.is_quick:
            return None
        with self._working:
            return self._edits(look).edit_verdict

    def _edit(self, look: DraftAnswer) -> Scene:
        return preview(look.job, self.registry)

    def begin_preview(self, look: DraftAnswer, job: str) -> None:
        """Write beside a job, in the background, what is selected and the 2D edit."""
        self._background.submit(self._preview, look, job)

    def _preview(self, look: DraftAnswer, job: str) -> None:
        views = look.views
        folder = self.folder.beside(job) / PREVIEW
        folder.mkdir()
        if look.is_quick:  # of slower editors the edit is seen with the result
            with suppress(Edit3rError), self._working:
                scene = self._edits(look)
                views = scene.edited
                _keep_verdict(scene.edit_verdict, folder)
        for view, name in enumerate(views.names):
            image = views.images[0, view]
            if look.masks is not None:
                image = outlined(image, look.masks[view])
            save_image(image, folder / f"{name}.jpg")

    def _open(self, state: str, names: tuple[str, ...]) -> _Opened:
        """Read a state's photos as a run does; `names` says which there are."""
        path = self.folder.path(state)
        if self.folder.is_run(state):
            cache = Cache(path / CACHE)
            photos, views = read_views_of_run(path)
        else:
            cache = Cache(self._answers(state))
            files = list(self.folder.photos(state).values())
            with _working_with(cache):
                photos = views = load_photos(files, size=self.size).views
        geometry = self._background.submit(self._geometry, photos, cache)
        clicked = self._background.submit(self._click_ahead, views, cache)
        clicked.add_done_callback(Future.result)  # prints what nobody expected
        if not self.folder.is_run(state):
            for reading in (geometry, clicked):
                reading.add_done_callback(lambda _: self._keep_answers(state, cache))
        return _Opened(views, cache, geometry)

    def _click_ahead(self, photos: Views, cache: Cache) -> None:
        """Click on the photos, so that the segmenter has read them when the user does."""
        choice = PartChoice(name=DEFAULTS["segmenter"])
        middle = Marks(positive=((0.5, 0.5),))
        for image in photos.images[0, :MAX_CLICKED_AHEAD]:
            # Between two photos a waiting user comes first.
            with self._working, _working_with(cache), suppress(Edit3rError):
                segmenter = self.registry.build_choice("segmenter", choice)
                segmenter.segment_marks(image, middle)

    def _answers(self, state: str) -> Path:
        """Where what was read from a set of photos is kept; changed by nothing but this."""
        return self.folder.beside(state) / CACHE

    def _keep_answers(self, state: str, cache: Cache) -> None:
        """Keep what was read from a set of photos for the next start of the server."""
        with self._working:
            if cache.computed:
                with atomic_folder(self._answers(state), overwrite=True) as partial:
                    cache.save(partial)

    def _geometry(self, photos: Views, cache: Cache) -> MatchedGeometry | None:
        """Poses and depths, as a run with the default reconstructor finds them."""
        with _working_with(cache):
            return geometry_of(default_matcher(self.registry), photos)

    def _look(self, opened: _Opened, text: str) -> DraftAnswer:
        draft = DRAFT.validate_json(text)
        look = DraftAnswer(opened.views)
        with _working_with(opened.cache) as told:
            try:
                config = make_run_config(run_settings(draft, self.registry))
                parts = Parts(config, self.registry, RunJob(config))
                if draft.selects:
                    look = _with_marks(look, draft, opened, parts)
                if config.prompt or config.editor is not None:
                    wishes = [wish for task in parts.tasks for wish in task.wishes]
                    said = "; ".join(map(str, wishes)) or config.prompt
                    look = replace(look, understood=f"{said} ({parts.editor_names})")
                    look = self._with_regions(look, opened.cache, parts)
            except Edit3rError as error:
                asks = isinstance(error, InputError)
                look = replace(look, problem=str(error), asks=asks)
        return replace(look, told=tuple(told))

    def _with_regions(
        self, look: DraftAnswer, cache: Cache, parts: Parts
    ) -> DraftAnswer:
        """Where the sentence applies, as a run finds it."""
        marked = None
        if look.marked is not None:
            marked = Selection(masks=dict(enumerate(look.marked)))
        job = RunJob(parts.config, look.views, masks=marked, cache=cache)
        scene = preview(job, self.registry, edits=False)
        sureties = [one.surety for one in scene.selected if one.surety is not None]
        used = [task.editor.offer.component for task in parts.tasks]
        return replace(
            look,
            masks=None if scene.masks is None else scene.masks[0],
            job=job,
            surety=min(sureties, default=look.surety),
            is_quick=not any(one.weights or one.needs_network for one in used),
        )


def _keep_verdict(verdict: EditVerdict | None, folder: Path) -> None:
    """Write the verdict on a preview as run.json will hold that on the whole run."""
    if verdict is not None:
        content = json.dumps({"edit_verdict": asdict(verdict)})
        with atomic_write(folder / "run.json") as partial:
            partial.write_text(content, encoding="utf-8")


def _with_marks(
    look: DraftAnswer, draft: Draft, opened: _Opened, parts: Parts
) -> DraftAnswer:
    """What the marks select on every photo."""
    geometry = None
    with suppress(NotYet):
        geometry = opened.geometry.result(GEOMETRY_PATIENCE)
    images = look.views.images[0]
    found = select_masks(
        images,
        draft.selection(look.views),
        parts.segmenter,
        geometry=geometry,
        intrinsics=look.views.intrinsics,
    )
    marked = found.masks[:, 0]
    outline = Selection(
        masks=dict(enumerate(marked)),
        grow=parts.config.grow,
        inverted=parts.config.invert,
    )
    masks = select_masks(images, outline, parts.segmenter).masks[:, 0]
    return replace(look, marked=marked, masks=masks, surety=found.surety)


@contextmanager
def _working_with(cache: Cache) -> Iterator[list[str]]:
    """Work as a run does; yields what components tell the user."""
    told: list[str] = []

    def hear(event: str, text: str, *counts: int) -> None:
        if event in ("say", "warn"):
            told.append(text)

    with collecting(Report(on_event=hear)), using(cache), torch.no_grad():
        yield told
