"""Which mask is meant: a sum of cues with fitted weights, the largest first."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from edit3r_select.cues import Pool, pixel, quality, stability, table

FITTED = Path(__file__).with_name("fitted.yaml")
SAME = 0.85
"""IoU of two masks from which a step from one to the other shows nothing."""
ALONE = 4.0
"""Lead of a mask that no other one contests, and the longest that tells more."""
DOT = 0.008
"""Radius of the dot that makes a mask obey a click [longer sides]."""
GIVEN_LOGIT = 4.0
"""Logit of a pixel that is given, as by a click; of what is surely outside its negative."""
NOTICED = 1.15
"""Ratio of two areas from which one mask is larger than the other."""
CERTAINTY = ("lead", "quality", "stability", "constant")
"""What tells whether the first mask is right."""


@dataclass(frozen=True, eq=False)
class CueWeights:
    """What multiplies each cue, for one kind of marks."""

    cues: tuple[str, ...]  # names in `cues.CUES`
    values: np.ndarray  # [cue], of cues as they are
    # of lead, quality and stability of the first mask, and a constant: whether it is right
    certainty: np.ndarray = field(default_factory=lambda: np.array([1.0, 0, 0, 0]))

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> "CueWeights":
        """The weights of an entry of `fitted.yaml`."""
        told = entry["weights"]
        values = np.array([told[name] for name in told], dtype=float)
        certainty = [entry["confidence"][name] for name in CERTAINTY]
        return cls(tuple(told), values, np.array(certainty))


@dataclass(frozen=True, eq=False)
class MaskCandidate:
    """One mask that may be meant."""

    logits: np.ndarray  # [h, w], > 0 inside
    score: float  # the sum; only differences between candidates of one question mean anything
    quality: float  # IoU that whoever made it expects, in [0, 1]

    @property
    def mask(self) -> np.ndarray:
        return self.logits > 0


@dataclass(frozen=True, eq=False)
class Chosen:
    """What marks may mean on one photo."""

    # the one that is taken first, then by their sums
    candidates: tuple[MaskCandidate, ...]
    # in [0, 1]: how likely the first has an IoU of 0.7 with what is meant; None: nobody can tell
    confidence: float | None

    @property
    def best(self) -> MaskCandidate:
        return self.candidates[0]

    def stepped(self, steps: int) -> MaskCandidate:
        """The candidate that is `steps` larger than the first; smaller, if negative."""
        ordered = sorted(self.candidates, key=lambda one: int(one.mask.sum()))
        place = ordered.index(self.best) + steps
        return ordered[min(max(place, 0), len(ordered) - 1)]


@cache
def fitted(kind: str) -> CueWeights:
    """The weights for a kind of marks (`Asked.kind`)."""
    return CueWeights.of(yaml.safe_load(FITTED.read_text())[kind])


def scores(pool: Pool, weights: CueWeights) -> np.ndarray:
    """The sum `[n]` of each mask."""
    return table(pool, weights.cues) @ weights.values


def choose(pool: Pool, weights: CueWeights, same: float = SAME) -> Chosen:
    """The masks of a pool, the one that is meant first; of those with an IoU of `same` the best."""
    values = scores(pool, weights)
    order: list[int] = []
    for index in np.argsort(-values, kind="stable").tolist():
        alike = any(pool.overlaps[index, order] > same)
        if not alike and pool.masks[index].any():
            order.append(index)
    order = order or [int(values.argmax())]
    candidates = tuple(
        MaskCandidate(
            obeying(pool, pool.logits[one]),
            float(values[one]),
            float(pool.quality[one]),
        )
        for one in order
    )
    sure = confidence(evidence(pool, values), weights) if pool.is_told else None
    return Chosen(candidates, sure)


def obeying(pool: Pool, logits: np.ndarray) -> np.ndarray:
    """Logits that obey every click: a dot of the mask is set or cleared where one does not."""
    obeyed = logits.copy()
    radius = max(1, round(DOT * max(pool.size)))
    for place, wanted in pool.asked.clicks:
        row, column = pixel(place, pool.size)
        if (obeyed[row, column] > 0) != wanted:
            cv2.circle(
                obeyed,
                (column, row),
                radius,
                GIVEN_LOGIT if wanted else -GIVEN_LOGIT,
                -1,
            )
    return obeyed


def evidence(pool: Pool, values: np.ndarray) -> np.ndarray:
    """What tells whether the mask with the largest sum is right: `CERTAINTY`."""
    best = int(values.argmax())
    told = quality(pool)[best], stability(pool)[best]
    return np.array([lead(values, pool.areas), *told, 1.0])


def confidence(told: np.ndarray, weights: CueWeights) -> float:
    """How likely the first mask has an IoU of 0.7 with what is meant."""
    return float(1 / (1 + np.exp(-(weights.certainty @ told))))


def lead(values: np.ndarray, areas: np.ndarray) -> float:
    """How far the largest sum is before the best of a mask that is noticeably larger or smaller;
    `ALONE` at most, and where there is none.
    """
    best = int(values.argmax())
    ratio = np.maximum(areas, 1e-6) / max(areas[best], 1e-6)
    other = np.maximum(ratio, 1 / ratio) > NOTICED
    ahead = values[best] - values[other].max() if other.any() else ALONE
    return float(min(ALONE, ahead))
