"""Marks on one photo, answered by the sum: a segmenter gives the masks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Protocol

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import SUBJECT, Proposal, Segmenter
from edit3r.kit import asking
from edit3r.kit.compute.outlines import soft_edged
from edit3r_select.cues import Asked, Box, Click, Place, Pool, pixel
from edit3r_select.marks import Marks
from edit3r_select.ranking import (
    GIVEN_LOGIT,
    Chosen,
    CueWeights,
    MaskCandidate,
    choose,
    fitted,
    obeying,
)

LONGER = 512  # longer side of a photo whose masks are compared: weights are for this [pixels]
ON_STROKE = 4  # places of a stroke, or of what is expected, that are asked together
UNTOLD = 0.5  # quality of a mask that no network made
CORRECTED = 0.5  # IoU with the answer before from which a further one corrects that
# Of what stands out where nothing is marked
GRID = 6  # clicks along each side
UNMARKED = 256  # longer side of the photo [pixels]
SMALLEST, LARGEST = 0.002, 0.95  # shares of the photo
LIKELIEST = 6  # candidates, at most
DISTINCT = 0.5  # IoU from which two are one thing

Image = Float[Tensor, "3 height width"]
Size = tuple[int, int]  # height and width
Answer = tuple[np.ndarray, np.ndarray | None]


class AnswersMarks(Protocol):
    def __call__(
        self,
        clicks: Sequence[Click],
        box: Box | None = None,
        before: np.ndarray | None = None,
    ) -> Answer:
        """A segmenter's `masks` on one photo: logits `[n, h, w]` of any size, which cover it, and
        the IoU that each mask is expected to have `[n]`; None where it cannot tell.
        """


def answers_of(segmenter: Segmenter, image: Image) -> AnswersMarks:
    """A segmenter's `masks` on one photo, in numpy."""

    def ask(
        clicks: Sequence[Click],
        box: Box | None = None,
        before: np.ndarray | None = None,
    ) -> Answer:
        given = None if before is None else torch.from_numpy(before)
        found = asking.masks(segmenter, image, clicks, box, given)
        quality = None if found.quality is None else found.quality.numpy(force=True)
        return found.logits.numpy(force=True), quality

    return ask


@dataclass(frozen=True)
class Answered:
    """All that marks may mean, the answer first; as sure as the sum is, the others share the rest.

    With `marks.larger` the answer, that many steps from the likeliest, is alone.
    """

    candidates: tuple[Proposal, ...]
    confidence: float | None  # that the first is meant; None: nobody can tell

    @property
    def mask(self) -> Float[Tensor, "height width"]:
        return self.candidates[0].soft_mask


def answered(segmenter: Segmenter, image: Image, marks: Marks) -> Answered:
    """What the marks mean on one photo."""
    scale = min(1.0, LONGER / max(image.shape[-2:]))
    height, width = (max(1, round(side * scale)) for side in image.shape[-2:])
    chosen = _chosen(answers_of(segmenter, image), (height, width), marks)
    if marks.larger:
        stepped = chosen.stepped(marks.larger)
        return Answered((_as_proposal(image, stepped, 1.0),), None)
    pairs = zip(chosen.candidates, _shares(chosen))
    found = tuple(_as_proposal(image, one, share) for one, share in pairs)
    return Answered(found, chosen.confidence)


def _chosen(ask: AnswersMarks, size: Size, marks: Marks) -> Chosen:
    """What the marks may mean by the sum, one click after the other.

    Nobody told in which order clicks on the thing and beside it were made: they come in turns, and
    one that says what is known waits until an answer to another one disobeys it.
    """
    chosen: Chosen | None = None
    inside = [(place, True) for place in marks.positive]
    outside = [(place, False) for place in marks.negative]
    waiting = [one for pair in zip_longest(inside, outside) for one in pair if one]
    if marks.known is not None:
        return selected(size, asked_by(marks, size), ask)
    if marks.prior is not None and waiting:
        expected = MaskCandidate(_as_logits(marks.prior, size), 0.0, 1.0)
        chosen = Chosen((expected,), None)
    elif marks.stroke or marks.box:
        chosen = selected(size, Asked((), marks.stroke, marks.box), ask)
    clicks: tuple[Click, ...] = ()
    while new := [one for one in waiting if not _obeyed(chosen, size, one)]:
        waiting.remove(new[0])
        clicks = (*clicks, new[0])
        before = None if chosen is None else chosen.best.logits
        chosen = selected(size, Asked(clicks, marks.stroke, marks.box, before), ask)
    assert chosen is not None, "nothing is marked"
    return chosen


def changed_at(pool: Pool) -> Pool:
    """The masks that answer a further click, with what does not hang together with the click as it
    was: nobody said that it is wrong. One that is largely another thing is taken whole.
    """
    before, (place, _) = pool.asked.before, pool.asked.clicks[-1]
    assert before is not None
    kept = []
    for after in (obeying(pool, one) for one in pool.logits):
        changed = (before > 0) != (after > 0)
        labels = cv2.connectedComponents(changed.astype(np.uint8), connectivity=4)[1]
        here = labels[pixel(place, changed.shape)]
        if here and _is_same(before > 0, after > 0):
            after = np.where(changed & (labels != here), before, after)
        kept.append(after)
    return replace(pool, logits=np.stack(kept))


def selected(
    size: Size, asked: Asked, ask: AnswersMarks, weights: CueWeights | None = None
) -> Chosen:
    """What is meant by marks on one photo, its masks at `size`."""
    pool, weights = gathered(size, asked, ask), weights or fitted(asked.kind)
    chosen = choose(pool, weights)
    return refined(pool, chosen, ask, weights) if asked.kind == "click" else chosen


def refined(
    pool: Pool, chosen: Chosen, ask: AnswersMarks, weights: CueWeights
) -> Chosen:
    """The first mask, or a better one of the same thing: people click anywhere, also at the rim, so
    that a second click is asked about, in the middle of the first mask, which is told with it.
    """
    first = chosen.best
    if not first.mask.any():
        return chosen
    place, _ = innermost(first.mask)
    logits, quality = ask([*pool.asked.clicks, (place, True)], before=first.logits)
    again = choose(pool_of(pool.asked, pool.size, [(logits, quality)]), weights)
    for one in again.candidates:
        if one.score > first.score and _is_same(one.mask, first.mask):
            return replace(chosen, candidates=(one, *chosen.candidates[1:]))
    return chosen


def gathered(size: Size, asked: Asked, ask: AnswersMarks) -> Pool:
    """All masks that answer the marks, at `size`."""
    drawn = [(place, True) for place in along(asked.stroke)]
    clicks, before = [*drawn, *asked.clicks], asked.before
    answers = [ask(clicks, asked.box)]
    if asked.kind == "stroke":
        answers.append(ask([drawn[len(drawn) // 2]]))
    if asked.expected is not None:
        given = (
            np.where(asked.expected, GIVEN_LOGIT, -GIVEN_LOGIT)[None],
            np.array([UNTOLD]),
        )
        answers += [ask(clicks), ask(clicks[:1]), given]
    if asked.kind == "more" and before is not None:
        answers.append(ask(clicks, asked.box, before))
        at_last = ask([(asked.clicks[-1][0], True)])
        answers.append(_joined(size, at_last, before, asked.clicks[-1][1]))
    pool = pool_of(asked, size, answers)
    return changed_at(pool) if asked.kind == "more" and before is not None else pool


def pool_of(asked: Asked, size: Size, answers: Sequence[Answer]) -> Pool:
    """All masks of some answers, at `size`."""
    logits = np.concatenate([_large(some, size) for some, _ in answers])
    quality = [
        np.full(len(some), UNTOLD) if good is None else good for some, good in answers
    ]
    return Pool(asked, logits, np.concatenate(quality), answers[0][1] is not None)


def subject_of(segmenter: Segmenter, image: Image) -> tuple[Proposal, ...]:
    """What stands out most, as the segmenter tells; () where it does not know."""
    return asking.words(segmenter, image, SUBJECT) or ()


def standing_out(segmenter: Segmenter, image: Image) -> tuple[Proposal, ...]:
    """What may be meant where nothing is marked, the likeliest first: the answers to a grid of
    clicks by the sum, to which what is salient is what is expected. Of a segmenter that cannot tell
    how good its masks are, what is salient.
    """
    salient = subject_of(segmenter, image)
    scale = min(1.0, UNMARKED / max(image.shape[-2:]))
    height, width = (max(1, round(side * scale)) for side in image.shape[-2:])
    expected = salient[0].soft_mask if salient else torch.zeros_like(image[0])
    pool = spread(answers_of(segmenter, image), (height, width), expected)
    if pool is None:
        return salient
    chosen = choose(pool, fitted("unmarked"), DISTINCT)
    pairs = list(zip(chosen.candidates, _shares(chosen)))
    return tuple(_as_proposal(image, one, share) for one, share in pairs[:LIKELIEST])


def spread(ask: AnswersMarks, size: Size, salient: Tensor) -> Pool | None:
    """Masks of clicks all over a photo, at `size`; None where there are none of a usual size, or
    nobody tells how good they are.
    """
    places = [(index + 0.5) / GRID for index in range(GRID)]
    answers: list[Answer] = []
    for click in [((x, y), True) for y in places for x in places]:
        answers.append(ask([click]))
        if answers[-1][1] is None:
            return None
    there, everywhere = _as_logits(salient, size) > 0, np.ones(size, dtype=bool)
    pool = pool_of(Asked(expected=there, known=everywhere), size, answers)
    usual = (pool.areas > SMALLEST) & (pool.areas < LARGEST)
    if not usual.any():
        return None
    return replace(pool, logits=pool.logits[usual], quality=pool.quality[usual])


def asked_by(marks: Marks, size: Size) -> Asked:
    """What is asked about a photo without marks: places deep inside of what is expected there, away
    from each other, and the box around it.
    """
    assert marks.prior is not None and marks.known is not None
    there = _as_logits(marks.prior, size) > 0
    known = _as_logits(marks.known, size) > 0
    rest = there.astype(np.uint8)
    clicks: list[Click] = []
    while rest.any() and len(clicks) < ON_STROKE:
        place, depth = innermost(rest)
        clicks.append((place, True))
        row, column = pixel(place, size)
        cv2.circle(rest, (column, row), round(2 * depth), 0, cv2.FILLED)
    x, y, width, height = cv2.boundingRect(there.astype(np.uint8))
    box = x / size[1], y / size[0], width / size[1], height / size[0]
    return Asked(tuple(clicks), box=box, expected=there & known, known=known)


def innermost(mask: np.ndarray) -> tuple[Place, float]:
    """The place deepest inside of a mask that is not empty, and how deep it lies [pixels]."""
    padded = np.pad(mask.astype(np.uint8), 1)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)[1:-1, 1:-1]
    height, width = mask.shape
    row, column = map(int, np.unravel_index(depth.argmax(), mask.shape))
    return ((column + 0.5) / width, (row + 0.5) / height), float(depth.max())


def along(stroke: Sequence) -> list:
    """At most `ON_STROKE` places, evenly along a stroke."""
    if len(stroke) <= ON_STROKE:
        return list(stroke)
    chosen = np.linspace(0, len(stroke) - 1, ON_STROKE).round().astype(int)
    return [stroke[index] for index in chosen]


def _joined(size: Size, answer: Answer, before: np.ndarray, wanted: bool) -> Answer:
    """The answer `before` with each part at the last click, or without it."""
    parts, whole = _large(answer[0], size), _large(before[None], size)
    return np.maximum(whole, parts) if wanted else np.minimum(whole, -parts), answer[1]


def _large(logits: np.ndarray, size: Size) -> np.ndarray:
    return np.stack([cv2.resize(np.float32(one), size[::-1]) for one in logits])


def _is_same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two masks show one thing, more or less of it."""
    return bool((one & other).sum() >= CORRECTED * (one | other).sum())


def _obeyed(chosen: Chosen | None, size: Size, click: Click) -> bool:
    place, wanted = click
    return chosen is not None and chosen.best.mask[pixel(place, size)] == wanted


def _shares(chosen: Chosen) -> Iterator[float]:
    """How likely each candidate is what is meant; they add up to 1."""
    first = 1.0 if chosen.confidence is None else chosen.confidence
    yield first
    scores = np.array([one.score for one in chosen.candidates[1:]])
    if len(scores):
        parts = np.exp(scores - scores.max())
        yield from ((1 - first) * parts / parts.sum()).tolist()


def _as_logits(mask: Tensor, size: Size) -> np.ndarray:
    values = cv2.resize(mask.float().numpy(force=True), size[::-1])
    return np.where(values > 0.5, GIVEN_LOGIT, -GIVEN_LOGIT).astype(np.float32)


def _as_proposal(image: Image, one: MaskCandidate, confidence: float) -> Proposal:
    """A candidate at the photo's size, its soft edge following the photo's own."""
    inside = cv2.resize(one.logits, tuple(image.shape[:0:-1])) > 0
    return Proposal(soft_edged(image, inside), confidence)
