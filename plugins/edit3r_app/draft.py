"""What was marked and typed on one state of a scene, kept in a file.

Marks and steps are a list in the order of making, so that the last can be undone.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import torch
from jaxtyping import Float
from pydantic import Field, TypeAdapter
from torch import Tensor

from edit3r.contract.errors import InputError, PromptError
from edit3r.contract.interfaces import Box, Selection
from edit3r.contract.types import Views
from edit3r.kit.files.atomic import atomic_write
from edit3r.running import MAX_GROWTH, MAX_STEPS, usual_reader
from edit3r_app.jobs import JobsFolder

MAX_MARKS = 200
MAX_PLACES = 4000  # of all strokes of the brush on a scene
SELECTS = {"add", "stroke", "box", "exact", "paint", "lasso"}
"""Marks that say what is meant, and not only what is not."""

Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class Mark:
    """One step of selecting; places are x and y in [0, 1] of a photo."""

    kind: Literal[
        "add", "remove", "stroke", "box", "exact", "paint", "erase", "lasso", "carve"
    ]
    photo: str  # its name
    # one; or two corners of a box, which is sought in or taken exactly; or those along a stroke, or
    # around what a lasso takes or carves away
    places: Annotated[list[tuple[Share, Share]], Field(min_length=1)]
    # of the brush, of the longer side
    radius: Annotated[float, Field(ge=0, le=0.5)] = 0.0


@dataclass(frozen=True)
class Step:
    """One step from what the marks or the sentence select to another candidate of it."""

    kind: Literal["larger", "candidate", "grow", "invert"]  # settings of a run
    # 1 for a larger candidate, -1 for a smaller one; the number of a candidate; the pixels to grow
    # by; of invert nothing
    value: Annotated[float, Field(ge=-MAX_GROWTH, le=MAX_GROWTH)] = 0.0


@dataclass
class Draft:
    """Marks and form of one state of a scene."""

    marks: list[Mark | Step] = field(default_factory=list)
    undone: list[Mark | Step] = field(default_factory=list)  # the last taken back last
    words: str = ""  # name the thing where nothing is marked
    chosen_for: str = ""  # the sentence for which the last candidate was chosen
    # what was typed: the sentence, names of components, settings
    form: dict[str, Any] = field(default_factory=dict)
    # of a set of photos, for all edits of it: marks by the name that the user gave them
    named: dict[str, list[Mark | Step]] = field(default_factory=dict)

    @property
    def selects(self) -> bool:
        """Whether it says what is meant, and not only what is not."""
        kinds = {mark.kind for mark in self.marks}
        return bool(self.words or kinds & SELECTS)

    @property
    def chose(self) -> bool:
        """Whether somebody looked at the candidates of what is meant now and chose one."""
        if not self._steps("candidate"):
            return False
        now = self.form.get("prompt", "")
        return self.selects or _things(now) == _things(self.chosen_for)

    @property
    def outline(self) -> dict[str, Any]:
        """What the steps come to: the settings larger, candidate, grow and invert of a run."""
        larger = sum(int(value) for value in self._steps("larger"))
        chosen = self._steps("candidate")[-1] if self.chose else 1.0
        return {
            "larger": min(max(larger, -MAX_STEPS), MAX_STEPS),
            "candidate": int(min(max(chosen, 1), MAX_STEPS)),
            "grow": [0.0, *self._steps("grow")][-1],
            "invert": len(self._steps("invert")) % 2 == 1,
        }

    def _steps(self, kind: str) -> list[float]:
        steps = (mark for mark in self.marks if isinstance(mark, Step))
        return [step.value for step in steps if step.kind == kind]

    def take(self, mark: Mark | Step) -> None:
        """Add a mark or a step; a further number of pixels replaces the one just given."""
        replaced = mark.kind in ("grow", "candidate")
        if replaced and self.marks and self.marks[-1].kind == mark.kind:
            self.marks.pop()
        self.marks.append(mark)
        self.undone = []
        if mark.kind == "candidate":
            self.chosen_for = self.form.get("prompt", "")

    def take_back(self) -> None:
        """Forget the last mark or step; the words where there is none."""
        if self.marks:
            self.undone.append(self.marks.pop())
        else:
            self.words = ""

    def take_again(self) -> None:
        """Take the mark or step again that was taken back last."""
        if self.undone:
            self.marks.append(self.undone.pop())

    def selection(self, views: Views) -> Selection:
        """The marks on these views; those on photos that a run left out are passed over.

        Of the steps it has the candidate alone: outlines are moved and inverted by the run.
        """

        def of(kind: str) -> Iterator[tuple[int, Mark]]:
            for mark in self.marks:
                if not isinstance(mark, Mark) or mark.kind != kind:
                    continue
                if mark.photo in views.names:
                    yield views.names.index(mark.photo), mark

        thing = usual_reader().read_target(self.words)
        return Selection(
            positive=tuple((view, *mark.places[0]) for view, mark in of("add")),
            negative=tuple((view, *mark.places[0]) for view, mark in of("remove")),
            boxes={view: _box(mark) for view, mark in of("box")},
            strokes=tuple((view, tuple(mark.places)) for view, mark in of("stroke")),
            added=_painted([*of("paint"), *of("lasso")], views.image_size),
            regions=tuple((view, _box(mark)) for view, mark in of("exact")),
            removed=_painted([*of("erase"), *of("carve")], views.image_size),
            words=thing.name,
            qualifiers=thing.qualifiers,
            larger=self.outline["larger"],
            candidate=self.outline["candidate"],
        )

    def as_json(self) -> str:
        return json.dumps(asdict(self))


MARK = TypeAdapter(Mark)
STEP = TypeAdapter(Step)
DRAFT = TypeAdapter(Draft)


def read_draft(folder: JobsFolder, state: str) -> Draft:
    """The draft of a set of photos or a run; an empty one where there is none that can be read."""
    with suppress(OSError, ValueError):
        return DRAFT.validate_json((folder.beside(state) / "draft.json").read_bytes())
    return Draft()


def write_draft(folder: JobsFolder, state: str, draft: Draft) -> None:
    """Keep a draft; raises InputError for more marks than anybody makes."""
    places = sum(len(mark.places) for mark in draft.marks if isinstance(mark, Mark))
    if len(draft.marks) > MAX_MARKS or places > MAX_PLACES:
        raise InputError(
            f"more than {MAX_MARKS} marks, or longer strokes than are kept; clear them, and begin "
            "with a box or a larger brush."
        )
    with atomic_write(folder.beside(state) / "draft.json") as partial:
        partial.write_text(draft.as_json(), encoding="utf-8")


def _things(sentence: str) -> list[str]:
    """What a sentence names; nothing where it cannot be read."""
    with suppress(PromptError):
        return [str(one.target) for one in usual_reader().read(sentence)]
    return []


def _box(mark: Mark) -> Box:
    """x, y, width and height of the box between two corners."""
    ends = zip(mark.places[0], mark.places[-1])
    (left, right), (top, bottom) = map(sorted, ends)
    return left, top, right - left, bottom - top


def _painted(
    strokes: Iterable[tuple[int, Mark]], size: tuple[int, int]
) -> dict[int, Float[Tensor, "height width"]]:
    """What strokes of the brush and lassos cover, as masks of 0 and 1 by view."""
    height, width = size
    masks: dict[int, np.ndarray] = {}
    for view, stroke in strokes:
        mask = masks.setdefault(view, np.zeros(size, np.float32))
        places = np.rint(np.multiply(stroke.places, (width, height)))
        places = places.astype(np.int32)
        if stroke.kind in ("lasso", "carve"):
            cv2.fillPoly(mask, [places], 1)
            continue
        thickness = max(1, round(2 * stroke.radius * max(size)))
        cv2.polylines(mask, [places], False, 1, thickness)
    return {view: torch.from_numpy(mask) for view, mask in masks.items()}
