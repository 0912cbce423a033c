"""The object that clicks describe, found among many candidates and corrected click by click.

Candidates come from the tree of regions and, where its weights are at hand, from learned salience
of crops around the first click. People click in the middle of what they mean: of the object first,
then of what is wrong. So each click takes the candidate that is a good object and whose difference
from the last answer has the click in its middle.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edit3r_segmenters.masks import distance_to, graph_cut, overlap, tidied
from edit3r_segmenters.salience import Objectness
from edit3r_segmenters.superpixels import Superpixels

THRESHOLDS = (0.25, 0.5, 0.75)  # of learned salience, each giving a candidate
# agreement with learned salience that counts for a candidate that no crop shows whole
UNSEEN = 0.25
CONTRADICTED = 0.5  # weight of a glimpse that a click contradicts
KEPT_POWER = 0.25  # weight of how much of the last answer stays
PART_POWER = (
    0.7  # weight of how much a candidate is one thing by its colours and outline
)
MOST_AREA = 0.9  # share of the picture above which a region is no object
SMALLEST = 12  # pixels of a candidate or of a correction
SEED = (
    0.5  # share of a click's distance to the outline that surely is as the click says
)


Click = tuple[tuple[int, int], bool]  # row and column, and whether the object is there


@dataclass(frozen=True)
class Glimpse:
    """Learned salience of one crop of the picture."""

    values: np.ndarray  # [H, W] float in [0, 1], 0 outside the crop
    known: np.ndarray  # [H, W] bool, the crop

    def agrees(self, click: Click) -> bool:
        """Whether it says of a place what the user says; nothing is said outside the crop."""
        place, wanted = click
        return not self.known[place] or (self.values[place] > 0.5) == wanted

    def agreement(self, mask: np.ndarray) -> float:
        """Soft intersection over union with a bool mask `[H, W]`; 0 where the crop does not show
        all of it.
        """
        inner = (
            cv2.erode(self.known.astype(np.uint8), np.ones((5, 5)), borderValue=1) > 0
        )
        cut = (mask & self.known & ~inner).sum() > 0.3 * np.sqrt(mask.sum())
        if cut or (mask & ~self.known).sum() > 0.02 * mask.sum():
            return 0.0
        inside = self.values[mask].sum()
        return float(inside / (mask.sum() + self.values.sum() - inside))


@dataclass(frozen=True)
class Picture:
    """All that is known of a picture at working size."""

    pixels: np.ndarray  # [H, W, 3] uint8 RGB
    superpixels: Superpixels
    members: np.ndarray  # [R, N] bool, superpixels of every region of the tree
    measure: Callable[[np.ndarray], Objectness | None]  # of a bool mask [H, W]
    glimpses: Sequence[Glimpse] = ()

    def quality(self, mask: np.ndarray, clicks: Sequence[Click]) -> float:
        """How good an object a bool mask `[H, W]` is; a glimpse that a click contradicts has less
        to say.
        """
        cues: Objectness | None = self.measure(mask)
        trusts = (
            1.0 if all(glimpse.agrees(click) for click in clicks) else CONTRADICTED
            for glimpse in self.glimpses
        )
        seen = max(
            (
                trust * glimpse.agreement(mask)
                for trust, glimpse in zip(trusts, self.glimpses)
            ),
            default=0.0,
        )
        return 0.0 if cues is None else (UNSEEN + seen) * cues.as_part**PART_POWER

    def regions(self, place: tuple[int, int]) -> Iterable[np.ndarray]:
        """Regions at a place (row, column): of the tree, and of learned salience; smaller ones
        first.
        """
        labels = self.superpixels.labels
        for row in self.members[self.members[:, labels[place]]]:
            yield row[labels]
        for glimpse in self.glimpses:
            for threshold in THRESHOLDS:
                part = component(glimpse.values > threshold, place)
                if part is not None:
                    yield part


def find(
    picture: Picture,
    positive: Sequence[tuple[int, int]],
    negative: Sequence[tuple[int, int]],
    prior: np.ndarray | None = None,
) -> np.ndarray:
    """The object as a bool mask `[H, W]`; places are (row, column), `prior` where it is
    expected.
    """
    mask = np.zeros(picture.pixels.shape[:2], dtype=bool) if prior is None else prior
    wholes = list(picture.regions(positive[0])) if positive and prior is None else []
    clicks = [(place, True) for place in positive] + [
        (place, False) for place in negative
    ]
    for number, (place, wanted) in enumerate(clicks):
        done = clicks[: number + 1]
        if mask.any() and mask[place] == wanted:  # says what is known already
            continue
        mask = _corrected(picture, mask, place, wanted, done, wholes)
    return mask


def _corrected(picture, mask, place, wanted, clicks, wholes) -> np.ndarray:
    """The best candidate that agrees with all clicks, given the answer before the last of them."""
    candidates = list(wholes)
    if mask.any():
        for region in picture.regions(place):
            candidates.append(mask | region if wanted else mask & ~region)
        candidates.append(_locally_cut(picture, mask, place, wanted))
    reach = distance_to(mask if wanted else ~mask)[place] if mask.any() else 0.0
    best, best_score = None, 0.0
    for candidate in candidates:
        if not SMALLEST <= candidate.sum() <= MOST_AREA * candidate.size:
            continue
        if any(candidate[spot] != said for spot, said in clicks):
            continue
        score = _middle(candidate ^ mask, place, reach) * (
            overlap(candidate, mask) ** KEPT_POWER if mask.any() else 1
        )
        if score > 0.2 * best_score:
            score *= picture.quality(candidate, clicks)
        if score > best_score:
            best, best_score = candidate, score
    return _locally_cut(picture, mask, place, wanted) if best is None else best


def _middle(change: np.ndarray, place: tuple[int, int], reach: float) -> float:
    """How much a place is the middle of the largest part of a change, in [0, 1].

    A change that fills little of the way from the click to the outline, `reach` [pixels], is not
    worth a click.
    """
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        change.astype(np.uint8), connectivity=4
    )
    here = labels[place]
    if not here:
        return 0.0
    depth = cv2.distanceTransform(
        np.pad((labels == here).astype(np.uint8), 1), cv2.DIST_L2, 5
    )[1:-1, 1:-1]
    areas = stats[1:, cv2.CC_STAT_AREA]
    filled = min(1.0, depth[place] / reach) if reach else 1.0
    return float(
        depth[place]
        / depth.max()
        * np.sqrt(filled * stats[here, cv2.CC_STAT_AREA] / areas.max())
    )


def _locally_cut(
    picture: Picture, mask: np.ndarray, place: tuple[int, int], wanted: bool
) -> np.ndarray:
    """Change a mask around a place only, by graph cut within twice its distance to the outline."""
    distance = (
        distance_to(mask if wanted else ~mask)[place]
        if mask.any()
        else 0.05 * mask.shape[0]
    )
    rows, columns = np.indices(mask.shape)
    away = np.hypot(rows - place[0], columns - place[1])
    trimap = np.where(mask, cv2.GC_FGD, cv2.GC_BGD).astype(np.uint8)
    trimap[away <= 2 * distance] = cv2.GC_PR_FGD if wanted else cv2.GC_PR_BGD
    trimap[away <= max(1.0, SEED * distance)] = cv2.GC_FGD if wanted else cv2.GC_BGD
    return graph_cut(picture.pixels, trimap, rounds=2)


def component(mask: np.ndarray, place: tuple[int, int]) -> np.ndarray | None:
    """The connected part of a bool mask `[H, W]` at a place, small holes filled; None where there
    is none.
    """
    if not mask[place]:
        return None
    labels = cv2.connectedComponents(mask.astype(np.uint8))[1]
    part = labels == labels[place]
    return tidied(part, part)
