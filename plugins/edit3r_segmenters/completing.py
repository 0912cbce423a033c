"""What another photo shows of a thing, completed by a network where it shows no more of it."""

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from edit3r.kit.compute.outlines import distance_to
from edit3r_segmenters.masks import overlap, tidied

MIN_OPEN = 0.2  # share of its rim of which nothing is known
MAX_ASKED = 4  # places at which a network is asked
PART_AGREED = 0.85  # share of an answer's known part that is expected
PART_CONFIRMED = 0.3  # share of all of an answer that is expected
SURELY_AGREED = 0.9  # overlap in what is known from which nothing more is asked
MIN_AGREED = 0.75  # overlap in what is known from which an answer is the object

Place = tuple[int, int]  # row and column
Click = tuple[Place, bool]  # and whether the object is there
Box = tuple[Place, Place]  # first row and column inside, and first ones beyond
Prompt = Callable[[Sequence[Click], Box | None], np.ndarray]
"""Asks a network: logits of several masks `[n, h, w]`."""


def completed(expected: np.ndarray, known: np.ndarray, prompt: Prompt) -> np.ndarray:
    """`expected`, a bool mask that holds where something is `known`, with what a network adds.

    The network is asked at several places of the mask. An answer that agrees with the mask in what
    is known is the object; one that lies within it there is a part of it.
    """
    if not expected.any() or _open_share(expected, known) < MIN_OPEN:
        return expected
    places = [(place, True) for place in _spread(expected)]
    # One question with all that is expected; most often no other is needed.
    answers = [answer > 0 for answer in prompt(places, _bounds(expected))]
    if max(_agreements_in(known, answers, expected)) < SURELY_AGREED:
        more, whole = _asked_in_turn(expected, known, prompt, places)
        answers += more
    else:
        whole = expected
    agreements = _agreements_in(known, answers, expected)
    if max(agreements) >= MIN_AGREED:
        whole = answers[int(np.argmax(agreements))]
    return tidied(whole, expected)


def _asked_in_turn(
    expected: np.ndarray, known: np.ndarray, prompt: Prompt, places: Sequence[Click]
) -> tuple[list[np.ndarray], np.ndarray]:
    """A network's answers at one place after another until one surely agrees, and `expected` with
    the parts that they add.
    """
    answers: list[np.ndarray] = []
    whole = expected.copy()
    for place in places:
        found = [answer > 0 for answer in prompt([place], None)]
        answers += found
        if max(_agreements_in(known, found, expected)) >= SURELY_AGREED:
            return answers, whole
        for answer in found:
            if _is_part(answer, expected, known):
                whole |= answer & ~known
    answers += [answer > 0 for answer in prompt(places, _bounds(whole))]
    return answers, whole


def _agreements_in(
    known: np.ndarray, answers: Sequence[np.ndarray], expected: np.ndarray
) -> list[float]:
    return [overlap(answer & known, expected) for answer in answers]


def _spread(mask: np.ndarray) -> list[Place]:
    """Places deep inside a bool mask, away from each other; the innermost first."""
    rest = mask.astype(np.uint8)
    places: list[Place] = []
    while rest.any() and len(places) < MAX_ASKED:
        depth = distance_to(rest == 0)
        row, column = map(int, np.unravel_index(depth.argmax(), depth.shape))
        places.append((row, column))
        cv2.circle(rest, (column, row), round(2 * depth.max()), 0, cv2.FILLED)
    return places


def _open_share(expected: np.ndarray, known: np.ndarray) -> float:
    """How much of the rim of a mask lies where nothing is known."""
    wide = cv2.dilate(expected.astype(np.uint8), np.ones((7, 7))) > 0
    rim = wide & ~expected
    return float((rim & ~known).sum() / max(1, rim.sum()))


def _is_part(answer: np.ndarray, expected: np.ndarray, known: np.ndarray) -> bool:
    confirmed = (answer & expected).sum()
    alone = confirmed >= PART_AGREED * (answer & known).sum()
    return bool(alone and confirmed >= PART_CONFIRMED * answer.sum())


def _bounds(mask: np.ndarray) -> Box:
    rows, columns = np.nonzero(mask)
    first = (int(rows.min()), int(columns.min()))
    return first, (int(rows.max()) + 1, int(columns.max()) + 1)
