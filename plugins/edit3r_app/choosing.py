"""What was marked and typed on a scene, kept in a file, and the masks that come of it, kept in
memory.
"""

import io
import json
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as NotYet
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Annotated, Any

import torch
from PIL import Image, ImageDraw
from pydantic import Field, TypeAdapter

from edit3r.cache import Cache, using
from edit3r.contract.interfaces import MatchedGeometry
from edit3r.contract.types import Views
from edit3r.errors import Edit3rError, InputError
from edit3r.io.atomic import atomic_write
from edit3r.io.images import load_photos, save_image, to_bytes
from edit3r.pipeline.config import DEFAULTS, RunConfig
from edit3r.pipeline.earlier import read_views_of_run
from edit3r.plugins.registry import default_registry
from edit3r.selection.select import Selected, Selection, select_masks
from edit3r_app.jobs import JobsFolder

MOST_MARKS = 200
MOST_PLACES = 4000  # of all brush strokes on a scene
# [s] that a click waits for poses and depths before masks are carried by pictures alone
GEOMETRY_PATIENCE = 20.0
TINT = torch.tensor([1.0, 0.25, 0.55])


Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class Stroke:
    """One stroke of the brush, or of the eraser, over one photo."""

    view: int
    add: bool
    radius: Annotated[float, Field(gt=0, le=0.5)]  # share of the photo's longer side
    places: Annotated[list[tuple[Share, Share]], Field(min_length=1)]


@dataclass
class Draft:
    """Marks and form of one state of a scene; places are x and y in [0, 1] of a photo."""

    positive: list[tuple[int, float, float]] = field(default_factory=list)
    negative: list[tuple[int, float, float]] = field(default_factory=list)
    boxes: dict[int, tuple[float, float, float, float]] = field(
        default_factory=dict
    )  # by photo: x, y, width, height
    strokes: list[Stroke] = field(default_factory=list)
    words: str = ""
    guess: bool = False
    form: dict[str, Any] = field(
        default_factory=dict
    )  # what was typed: the wish, names of components, settings

    @property
    def marked(self) -> bool:
        return bool(
            self.positive
            or self.boxes
            or self.words
            or any(stroke.add for stroke in self.strokes)
        )

    @property
    def marks(self) -> str:
        """All that masks depend on, as JSON."""
        return json.dumps(
            {key: value for key, value in asdict(self).items() if key != "form"}
        )

    def selection(self, height: int, width: int) -> Selection:
        """The marks on photos of this size [pixels]."""
        marks = (tuple(self.positive), tuple(self.negative), dict(self.boxes))
        brushes = (
            _painted([one for one in self.strokes if one.add == add], height, width)
            for add in (True, False)
        )
        return Selection(*marks, *brushes, words=self.words, guess=self.guess)

    def clear_marks(self) -> None:
        (
            self.positive,
            self.negative,
            self.boxes,
            self.strokes,
            self.words,
            self.guess,
        ) = [], [], {}, [], "", False


_DRAFT = TypeAdapter(Draft)


def read_draft(folder: JobsFolder, state: str) -> Draft:
    """The draft of a set of photos or a run; an empty one where there is none that can be read."""
    with suppress(OSError, ValueError):
        return _DRAFT.validate_json((folder.beside(state) / "draft.json").read_bytes())
    return Draft()


def write_draft(folder: JobsFolder, state: str, draft: Draft) -> None:
    if len(draft.positive) + len(draft.negative) > MOST_MARKS:
        raise InputError(
            f"more than {MOST_MARKS} clicks; clear them and begin with a box."
        )
    if (
        len(draft.strokes) > MOST_MARKS
        or sum(len(stroke.places) for stroke in draft.strokes) > MOST_PLACES
    ):
        raise InputError(
            "more strokes of the brush than are kept; clear them, and paint with a larger brush."
        )
    with atomic_write(folder.beside(state) / "draft.json") as partial:
        partial.write_text(json.dumps(asdict(draft)), encoding="utf-8")


class Chooser:
    """Answers marks with masks. One call works at a time; the geometry of a scene is read once, in
    the background.
    """

    def __init__(
        self, folder: JobsFolder, size: int, segmenter: str | None = None
    ) -> None:
        self.folder, self.size = folder, size
        name = segmenter or DEFAULTS["segmenter"]
        self._segmenter = lru_cache(maxsize=1)(
            lambda: default_registry().build("segmenter", name)
        )  # keeps its weights
        self._working, self._reading = threading.Lock(), threading.Lock()
        self._background = ThreadPoolExecutor(1)
        self._views = lru_cache(maxsize=4)(self._read_views)
        self._geometry = lru_cache(maxsize=4)(self._begin_geometry)
        self._answers = lru_cache(maxsize=64)(self._select)

    def views(self, state: str) -> Views:
        """The views of a set of photos, or of a run the edited ones, on which its masks lie."""
        return self._both(state)[1]

    def _both(self, state: str) -> tuple[Views, Views]:
        """The unedited and the edited views."""
        with self._reading:
            return self._views(state, self._stamp(state))

    def prepare(self, state: str) -> None:
        """Begin to read the geometry."""
        self._geometry(state, self._stamp(state))

    def masks(self, state: str, draft: Draft) -> Selected | None:
        """The masks of a draft; None where nothing is marked. Raises InputError where the marks do
        not say what.
        """
        if not draft.marked:
            return None
        with self._working, torch.no_grad():
            return self._answers(state, self._stamp(state), draft.marks)

    def picture(self, state: str, draft: Draft, view: int) -> bytes:
        """JPEG of one photo with its mask tinted and outlined, and the marks drawn."""
        image = self.views(state).images[0, view]
        with suppress(Edit3rError):
            if (found := self.masks(state, draft)) is not None:
                image = _tinted(image, found.masks[view, 0])
        drawn = Image.fromarray(to_bytes(image))
        _draw_marks(drawn, draft, view)
        buffer = io.BytesIO()
        drawn.save(buffer, "JPEG", quality=88)
        return buffer.getvalue()

    def save_masks(self, state: str, draft: Draft, job: str) -> int:
        """Write the masks for a job, one file for each photo, and return their number; 0 where
        nothing is marked.
        """
        found = self.masks(state, draft)
        for index, mask in enumerate(found.masks if found is not None else ()):
            save_image(
                mask.expand(3, -1, -1), self.folder.beside(job) / f"{index:03}.png"
            )
        return 0 if found is None else len(found.masks)

    def _stamp(self, state: str) -> tuple[str, ...]:
        """Changes when photos were added or taken away."""
        return tuple(path.name for path in self.folder.photos(state))

    def _read_views(self, state: str, stamp: tuple[str, ...]) -> tuple[Views, Views]:
        if self.folder.is_run(state):
            return read_views_of_run(self.folder.path(state))
        views = load_photos(self.folder.photos(state), size=self.size).views
        return views, views

    def _begin_geometry(
        self, state: str, stamp: tuple[str, ...]
    ) -> "Future[MatchedGeometry | None]":
        return self._background.submit(self._read_geometry, state)

    def _read_geometry(self, state: str) -> MatchedGeometry | None:
        """Poses and depths by the matcher of the default reconstructor; None where the photos do
        not fit together.
        """
        choice = RunConfig.model_fields["reconstructor"].default
        matcher = (
            default_registry()
            .build_choice("reconstructor", choice)
            .parts.get("matcher")
        )
        kept = (
            self.folder.path(state)
            if self.folder.is_run(state)
            else self.folder.beside(state)
        ) / "cache"
        cache = Cache(kept)
        with suppress(Edit3rError), using(cache), torch.no_grad():
            views, _ = self._both(state)
            geometry = (
                None if matcher is None or views.count < 2 else matcher.match(views)
            )
            if not self.folder.is_run(state):
                cache.save(kept)
            return geometry
        return None

    def _select(self, state: str, stamp: tuple[str, ...], marks: str) -> Selected:
        views, geometry = self.views(state), None
        with suppress(NotYet):
            geometry = self._geometry(state, stamp).result(GEOMETRY_PATIENCE)
        segmenter = self._segmenter()
        selection = _DRAFT.validate_json(marks).selection(*views.images.shape[-2:])
        return select_masks(
            views.images[0], selection, segmenter, geometry, views.intrinsics
        )


def _painted(strokes: list[Stroke], height: int, width: int) -> dict[int, torch.Tensor]:
    """What the strokes cover, as masks [height, width] of 0 and 1 by view."""
    drawn: dict[int, Image.Image] = {}
    for stroke in strokes:
        pen = ImageDraw.Draw(
            drawn.setdefault(stroke.view, Image.new("L", (width, height)))
        )
        radius = max(1.0, stroke.radius * max(width, height))
        places = [(x * width, y * height) for x, y in stroke.places]
        pen.line(places, fill=255, width=round(2 * radius), joint="curve")
        for x, y in (places[0], places[-1]):
            pen.ellipse([x - radius, y - radius, x + radius, y + radius], fill=255)
    return {
        view: torch.frombuffer(bytearray(one.tobytes()), dtype=torch.uint8).view(
            height, width
        )
        / 255
        for view, one in drawn.items()
    }


def _tinted(image: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """The image [3, H, W] darker outside the mask [H, W], tinted inside, with the mask's outline in
    white.
    """
    inside = torch.nn.functional.max_pool2d((mask > 0.5).float()[None, None], 3, 1, 1)[
        0, 0
    ]
    outline = ((inside > 0) & (mask <= 0.5)).float()
    mixed = (
        image * (0.55 + 0.45 * mask) * (1 - 0.45 * mask)
        + 0.45 * mask * TINT[:, None, None]
    )
    return mixed * (1 - outline) + outline


def _draw_marks(image: Image.Image, draft: Draft, view: int) -> None:
    pen, radius = ImageDraw.Draw(image), max(3, max(image.size) // 90)
    if view in draft.boxes:
        x, y, width, height = draft.boxes[view]
        corners = [
            x * image.width,
            y * image.height,
            (x + width) * image.width,
            (y + height) * image.height,
        ]
        pen.rectangle(corners, outline="white", width=max(1, radius // 3))
    for places, colour in ((draft.positive, "#12a150"), (draft.negative, "#d92d20")):
        for x, y in [
            (x * image.width, y * image.height) for on, x, y in places if on == view
        ]:
            pen.ellipse(
                [x - radius, y - radius, x + radius, y + radius],
                fill=colour,
                outline="white",
                width=2,
            )
