"""How well the edit came out, beside the verdict on the scene: the right thing, and all of it?

Nobody knows what was meant, so signs are read: does the outline of what was selected follow edges,
do the photos agree about it, did it change as the sentence asks, does the 3D scene show the change.
The limits were chosen on edits of which it is known whether they are good; see docs/verdict.md.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

from edit3r.contract.interfaces import SURE
from edit3r.contract.verdicts import EditLabel, EditVerdict

MIN_SHARE = 0.0008  # of the photo that shows most of what was selected
MIN_OF_LARGEST = 0.1  # share of a photo over the largest such share
MAX_CLICKED = 0.38
MAX_PIECES = 0.15
MAX_PART = 0.65
MIN_CHANGED = 0.1
MIN_TAKEN = 0.58
MIN_OUTLINE = 0.8
MAX_OPEN_OUTLINE = 0.09
MAX_GHOST = 0.72
MAX_MADE_UP = 0.08
MIN_REACHED = 0.88
MIN_AGREEMENT = 0.77
MIN_SHOWN = 0.7
MAX_MISSED = 0.066


@dataclass(frozen=True)
class EditMeasures:
    """One figure for each way in which an edit goes wrong; None where it cannot be told."""

    # share of each photo that may change
    shares: tuple[float, ...]
    # share of what may change that visibly changed
    changed: float
    # what shows that pictures of the editor are not edits of their photos, a clause each
    faults: tuple[str, ...] = ()
    # what was undone of pictures that had moved against their photos, a clause each
    moved: tuple[str, ...] = ()
    # share of a photo that a click or a box without a name took; the largest over the photos
    clicked: float | None = None
    # share of what a click took that lies apart from its largest piece; the largest
    pieces: float | None = None
    # how likely a part of another colour was meant instead, beside what was taken, and its reading
    part: float | None = None
    part_reading: int = 0
    # share of a thing that took the colour, where the rest of it has much the same own colour
    taken: float | None = None
    # share of a photo that shows what was made up behind a removed thing, without texture
    made_up: float | None = None
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
    # largest patch of what was painted that the 3D scene shows as it was, as a share of it
    missed: float | None = None


def judge_edit(measures: EditMeasures, confidence: float | None = None) -> EditVerdict:
    """Judge an edit by its figures."""
    doubts = list(_doubts(measures, confidence))
    label: EditLabel = "doubtful" if doubts else "good"
    reason = "; ".join(doubts) or _praise(measures)
    return EditVerdict(label, reason, confidence, asdict(measures))


def _doubts(found: EditMeasures, confidence: float | None) -> Iterator[str]:
    """What speaks against the edit: against what was selected, then against what was made."""
    yield from found.faults
    yield from _doubts_of_meaning(found, confidence)
    yield from _doubts_of_selection(found)
    yield from _doubts_of_change(found)
    if found.shown is not None and found.shown < MIN_SHOWN:
        yield f"only {max(0.0, found.shown):.0%} of the change arrived in the 3D scene"
    elif _is_over(found.missed, MAX_MISSED):
        share = f"{found.missed:.0%}"
        yield f"a patch of {share} of what was changed is as it was in the 3D scene"


def _doubts_of_meaning(found: EditMeasures, confidence: float | None) -> Iterator[str]:
    """Whether it is the thing that was meant."""
    if confidence == 0:
        yield "which thing is meant was guessed"
    elif confidence is not None and confidence < SURE:
        yield f"the thing was found by its name with {confidence:.0%} confidence only"
    if _is_over(found.clicked, MAX_CLICKED):
        yield (
            f"{found.clicked:.0%} of a photo was taken for the thing that was clicked on "
            "(--smaller takes less, a name says how far it goes)"
        )
    if _is_over(found.part, MAX_PART):
        yield (
            "a part of what was taken has other colours and may be all that is meant (--reading "
            f"{found.part_reading} takes that)"
        )


def _doubts_of_selection(found: EditMeasures) -> Iterator[str]:
    """Whether what was selected is one thing, and the same in all photos."""
    if max(found.shares) < MIN_SHARE:
        yield "next to nothing was selected"
    elif min(found.shares) < MIN_OF_LARGEST * max(found.shares):
        photo = found.shares.index(min(found.shares)) + 1
        yield f"next to nothing was selected in photo {photo}"
    if _is_under(found.outline, MIN_OUTLINE):
        yield "the outline of what was selected leaves the edges in the photos"
    elif _is_over(found.open_outline, MAX_OPEN_OUTLINE):
        yield "the outline of what was selected runs through one surface"
    if _is_over(found.pieces, MAX_PIECES):
        yield "what was selected lies in several pieces"
    if _is_under(found.agreement, MIN_AGREEMENT):
        yield "what was selected differs between the photos"


def _doubts_of_change(found: EditMeasures) -> Iterator[str]:
    """Whether it changed as was asked."""
    if found.changed < MIN_CHANGED:
        part = "what was selected" if min(found.shares) < 1 else "the picture"
        yield f"only {found.changed:.0%} of {part} changed visibly"
    elif found.taken is not None and found.taken < MIN_TAKEN:
        share = f"{found.taken:.0%}"
        yield f"only {share} of what was selected took the colour ('all of it' paints the rest too)"
    if _is_over(found.ghost, MAX_GHOST):
        yield "the outline of what was removed still shows"
    if _is_over(found.made_up, MAX_MADE_UP):
        yield "much of what appears behind what was removed is made up"
    if found.reached is not None and found.reached < MIN_REACHED:
        yield f"{1 - found.reached:.0%} of what changed does not look as asked"


def _is_over(figure: float | None, most: float) -> bool:
    return figure is not None and figure > most


def _is_under(figure: float | None, least: float) -> bool:
    return figure is not None and figure < least


def _praise(measures: EditMeasures) -> str:
    part = "what was selected" if min(measures.shares) < 1 else "the picture"
    share = "all" if measures.changed > 0.985 else f"{measures.changed:.0%}"
    text = f"{share} of {part} changed visibly"
    if measures.shown is None:
        return text
    return f"{text}, and the 3D scene shows it"
