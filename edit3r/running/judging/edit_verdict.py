"""How well the edit came out, beside the verdict on the scene: the right thing, and all of it?

Nobody knows what was meant, so signs are read: does the outline of what was selected follow edges,
do the photos agree about it, did it change as the sentence asks, does the 3D scene show the change.
The limits were chosen on edits of which it is known whether they are good; see docs/verdict.md.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from edit3r.running.selecting.select import SURE

EditLabel = Literal["good", "doubtful"]

MIN_SHARE = 0.0008  # of the photo that shows most of what was selected
MIN_CHANGED = 0.08
MIN_OUTLINE = 0.8
MAX_OPEN_OUTLINE = 0.09
MAX_GHOST = 0.5
MIN_REACHED = 0.6
MIN_AGREEMENT = 0.68
MIN_SHOWN = 0.65


@dataclass(frozen=True)
class EditMeasures:
    """One figure for each way in which an edit goes wrong; None where it cannot be told."""

    # share of each photo that may change
    shares: tuple[float, ...]
    # share of what may change that visibly changed
    changed: float
    # how much the masks' outlines follow edges; 0: no more than chance, 1: all of them
    outline: float | None = None
    # longest stretch of an outline with the same colours on both sides, as its share
    open_outline: float | None = None
    # share of a removed thing's outline that is still an edge
    ghost: float | None = None
    # share of what visibly changed that looks as asked
    reached: float | None = None
    # overlap of the masks between photos, on the scene's surfaces
    agreement: float | None = None
    # share of the change in 2D that the 3D scene shows
    shown: float | None = None


@dataclass(frozen=True)
class EditVerdict:
    """The label of an edit, why, and the figures behind it."""

    label: EditLabel
    reason: str  # what is doubtful, in one sentence; what was measured where nothing is
    # how surely words or a guess found the thing, in [0, 1]; 0: a guess; None: it was marked
    surety: float | None
    measures: EditMeasures

    def __str__(self) -> str:
        return f"{self.label}, {self.reason}"


def judge_edit(measures: EditMeasures, surety: float | None = None) -> EditVerdict:
    """Judge an edit by its figures."""
    doubts = list(_doubts(measures, surety))
    label: EditLabel = "doubtful" if doubts else "good"
    reason = "; ".join(doubts) or _praise(measures)
    return EditVerdict(label, reason, surety, measures)


def _doubts(found: EditMeasures, surety: float | None) -> Iterator[str]:
    """What speaks against the edit: against what was selected, then against what was made."""
    yield from _doubts_of_selection(found, surety)
    if found.changed < MIN_CHANGED:
        part = "what was selected" if min(found.shares) < 1 else "the picture"
        yield f"only {found.changed:.0%} of {part} changed visibly"
    if found.ghost is not None and found.ghost > MAX_GHOST:
        yield "the outline of what was removed still shows"
    if found.reached is not None and found.reached < MIN_REACHED:
        yield f"{1 - found.reached:.0%} of what changed does not look as asked"
    if found.shown is not None and found.shown < MIN_SHOWN:
        yield f"only {max(0.0, found.shown):.0%} of the change arrived in the 3D scene"


def _doubts_of_selection(found: EditMeasures, surety: float | None) -> Iterator[str]:
    if max(found.shares) < MIN_SHARE:
        yield "next to nothing was selected"
    if surety == 0:
        yield "which thing is meant was guessed"
    elif surety is not None and surety < SURE:
        yield f"the thing was found by its name with {surety:.0%} surety only"
    if found.outline is not None and found.outline < MIN_OUTLINE:
        yield "the outline of what was selected leaves the edges in the photos"
    elif found.open_outline is not None and found.open_outline > MAX_OPEN_OUTLINE:
        yield "the outline of what was selected runs through one surface"
    if found.agreement is not None and found.agreement < MIN_AGREEMENT:
        yield "what was selected differs between the photos"


def _praise(measures: EditMeasures) -> str:
    part = "what was selected" if min(measures.shares) < 1 else "the picture"
    share = "all" if measures.changed > 0.985 else f"{measures.changed:.0%}"
    text = f"{share} of {part} changed visibly"
    if measures.shown is None:
        return text
    return f"{text}, and the 3D scene shows it"
