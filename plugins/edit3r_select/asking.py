"""Gathers masks that marks may mean from anything that answers them: any SAM.

An answerer is bound to its photo: `partial(segmenter.ask, image)`.
"""

from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np

from edit3r_select.cues import Appearance, Asked, Box, Click, Pool
from edit3r_select.sum import Chosen, CueWeights, choose, fitted

SINGLE_AND_SEVERAL = 4  # masks of a SAM that gives its single one before its several
ON_STROKE = 4  # places of a stroke that are asked together


class AnswersMarks(Protocol):
    def __call__(
        self,
        clicks: Sequence[Click],
        box: Box | None = None,
        before: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Masks for clicks, a box and the logits `[h, w]` of the answer `before` the last click.

        Returns logits `[n, h, w]` of any size, which cover the photo, and the IoU that each is
        expected to have `[n]`, in [0, 1]; None where there are no such answers.
        """


def selected(
    photo: Appearance,
    asked: Asked,
    answers: AnswersMarks,
    before: np.ndarray | None = None,
    weights: CueWeights | None = None,
) -> Chosen | None:
    """What is meant by marks on one photo; `before` are the logits of the answer before the last
    click. None where `answers` has none.
    """
    pool = gathered(photo, asked, answers, before)
    return None if pool is None else choose(pool, weights or fitted(asked.kind))


def gathered(
    photo: Appearance,
    asked: Asked,
    answers: AnswersMarks,
    before: np.ndarray | None = None,
) -> Pool | None:
    """All masks that answer the marks, at the photo's size; None where `answers` has none."""
    found = _Found(photo)
    drawn = [(place, True) for place in spread(asked.stroke, ON_STROKE)]
    clicks = [*drawn, *asked.clicks]
    told = answers(clicks, asked.box)
    if told is None:
        return None
    found.add(told)
    if asked.kind == "stroke":
        found.add(answers([drawn[len(drawn) // 2]]))
        found.add(answers(drawn, _around(asked.stroke)))
    if asked.kind == "more" and before is not None:
        found.add(answers(clicks, asked.box, before))
        found.join(answers([(asked.clicks[-1][0], True)]), before, asked.clicks[-1])
    return found.pool(asked)


def spread(stroke: Sequence, most: int) -> list:
    """Some places, evenly along a stroke."""
    if len(stroke) <= most:
        return list(stroke)
    chosen = np.linspace(0, len(stroke) - 1, most).round().astype(int)
    return [stroke[index] for index in chosen]


class _Found:
    """Masks as they come, made as large as the photo."""

    def __init__(self, photo: Appearance) -> None:
        self.photo = photo
        self.logits: list[np.ndarray] = []
        self.quality: list[float] = []
        self.first: list[bool] = []

    def add(self, answer: tuple[np.ndarray, np.ndarray] | None) -> None:
        logits, quality = answer or ((), ())
        single = len(logits) == SINGLE_AND_SEVERAL
        for number, (one, good) in enumerate(zip(logits, quality)):
            self.logits.append(self._large(one))
            self.quality.append(float(good))
            self.first.append(single and number == 0)

    def join(
        self,
        answer: tuple[np.ndarray, np.ndarray] | None,
        before: np.ndarray,
        click: Click,
    ) -> None:
        """The answer `before` with the part at the last click, or without it."""
        whole = self._large(before)
        for one, good in zip(*(answer or ((), ()))):
            part = self._large(one)
            if click[1]:
                joined = np.maximum(whole, part)
            else:
                joined = np.minimum(whole, -part)
            self.logits.append(joined)
            self.quality.append(float(good))
            self.first.append(False)

    def pool(self, asked: Asked) -> Pool:
        return Pool(
            self.photo,
            asked,
            np.stack(self.logits),
            np.array(self.quality),
            np.array(self.first),
        )

    def _large(self, logits: np.ndarray) -> np.ndarray:
        height, width = self.photo.size
        return cv2.resize(np.float32(logits), (width, height))


def _around(stroke: Sequence) -> Box:
    """The box around a stroke."""
    low, high = np.min(stroke, axis=0), np.max(stroke, axis=0)
    (x, y), (width, height) = low.tolist(), (high - low).tolist()
    return x, y, width, height
