"""What marks may mean where no network answers them: candidates are gathered, and ranked.

Candidates come from learned salience and from regions of like colours. People click somewhere on
the object first, then in the middle of what is wrong. So a candidate counts by how much the click
is the middle of what it changes, by how much what stands out agrees with it, and by how much it is
one thing by its colours and outline. All masks are bool `[h, w]` at one working size.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from edit3r.kit.compute.outlines import distance_to, overlap
from edit3r_segmenters.masks import graph_cut, tidied
from edit3r_segmenters.salience import Objectness
from edit3r_segmenters.superpixels import Superpixels

THRESHOLDS = (0.25, 0.5, 0.75)  # of learned salience, each giving a candidate
MAX_AREA = 0.9  # share of the image above which a region is no object
MIN_AREA = 12  # pixels of a candidate
# share of a click's distance to the outline that surely is as the click says
SEED = 0.5
# Powers of what a candidate counts by
MIDDLE_POWER = 2.0
SALIENCE_POWER = 1.0
STROKE_SALIENCE_POWER = 0.5
PART_POWER = 0.7
KEPT_POWER = 0.25  # how much of the last answer stays
ALONE = 0.1  # agreement that counts for a candidate that nothing agrees with
HELD = 0.8  # share of a stroke's points that a reading must hold
SAME = 0.85  # overlap of two candidates above which a step from one to the other shows nothing
MIN_SCORE = 0.02  # of the best one's score, under which a candidate is no step either

Place = tuple[int, int]  # row and column
Click = tuple[Place, bool]  # and whether the object is there
Box = tuple[Place, Place]  # first row and column inside, and first ones beyond


@dataclass(frozen=True)
class Salience:
    """Learned salience of the image or of a crop of it."""

    values: np.ndarray  # [h, w] in [0, 1], 0 outside the crop
    known: np.ndarray  # [h, w] bool, the crop

    def parts(self, place: Place) -> Iterable[np.ndarray]:
        """What stands out at a place, under several thresholds; not what the crop cuts."""
        inner = cv2.erode(self.known.astype(np.uint8), np.ones((5, 5)), borderValue=1)
        rim = self.known & (inner == 0)
        for threshold in THRESHOLDS:
            part = component(self.values > threshold, place)
            if part is not None and not (part & rim).any():
                yield part


@dataclass(frozen=True)
class Evidence:
    """All that is known of one image at working size."""

    pixels: np.ndarray  # [h, w, 3] uint8 RGB
    superpixels: Superpixels
    members: np.ndarray  # [R, N] bool, superpixels of every region of the tree
    measure: Callable[[np.ndarray], Objectness | None]  # of a bool mask
    saliences: Sequence[Salience] = ()

    def regions(self, place: Place) -> list[np.ndarray]:
        """Bool masks of regions at a place, smaller ones first."""
        labels = self.superpixels.labels
        return [row[labels] for row in self.members[self.members[:, labels[place]]]]

    def salient(self, place: Place) -> list[np.ndarray]:
        return [part for one in self.saliences for part in one.parts(place)]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A mask that the marks may mean, and how likely it is meant beside others of one image."""

    mask: np.ndarray  # [h, w] bool
    score: float


def choose(
    evidence: Evidence,
    clicks: Sequence[Click],
    box: Box | None = None,
    prior: np.ndarray | None = None,
    stroke: Sequence[Place] = (),
) -> list[Candidate]:
    """Readings of the marks, best first; `prior` is a bool mask of where the object is expected,
    `stroke` are places along which the object was drawn over.

    Empty where nothing at the first click can be an object.
    """
    found: list[Candidate] = []
    if prior is not None:
        found = [Candidate(prior, 1.0)]
    elif box is not None:
        found = _in_box(evidence, box, clicks)
    elif stroke:
        found = _stroked(evidence, stroke) or _first(evidence, stroke[len(stroke) // 2])
    for number, (place, wanted) in enumerate(clicks):
        if found and found[0].mask[place] == wanted:  # says what is known already
            continue
        done = clicks[: number + 1]
        if found:
            found = _corrected(evidence, found[0].mask, done)
        else:
            found = _first(evidence, place)
    return found


def by_size(candidates: Sequence[Candidate]) -> tuple[list[Candidate], int]:
    """The candidates that differ, smallest first, and the place of the best one among them."""
    kept: list[Candidate] = []
    for one in candidates:
        poor = one.score < MIN_SCORE * candidates[0].score
        known = any(overlap(one.mask, other.mask) > SAME for other in kept)
        if not (poor or known):
            kept.append(one)
    ordered = sorted(kept, key=lambda one: one.mask.sum())
    return ordered, ordered.index(candidates[0])


def _first(evidence: Evidence, place: Place) -> list[Candidate]:
    """Readings of the first click."""
    nothing = np.zeros(evidence.pixels.shape[:2], bool)
    masks = [*evidence.salient(place), *evidence.regions(place)]
    found = _ranked(evidence, nothing, [(place, True)], masks)
    cut = Candidate(_locally_cut(evidence.pixels, nothing, place, True), 0.0)
    return found or [cut]


def _stroked(evidence: Evidence, places: Sequence[Place]) -> list[Candidate]:
    """Readings of all places of a stroke at once, that hold nearly all of them."""
    salient = evidence.salient(places[len(places) // 2])
    regions = [mask for place in places for mask in evidence.regions(place)]
    found = []
    for mask in (*salient, *regions):
        cues = evidence.measure(mask)
        usual = MIN_AREA <= mask.sum() <= MAX_AREA * mask.size
        if cues is None or not usual or not _holds(mask, places):
            continue
        score = (ALONE + cues.as_part) ** PART_POWER
        score *= _agreement(mask, salient, STROKE_SALIENCE_POWER)
        found.append(Candidate(mask, float(score)))
    return sorted(found, key=lambda one: -one.score)


def _holds(mask: np.ndarray, places: Sequence[Place]) -> bool:
    """Whether a bool mask holds nearly all places."""
    return bool(np.mean([mask[place] for place in places]) >= HELD)


def _corrected(
    evidence: Evidence, before: np.ndarray, clicks: Sequence[Click]
) -> list[Candidate]:
    """Readings of all clicks, given the answer `before` the last of them: the part at the click is
    added or taken away, or the first click was read as another thing.
    """
    place, wanted = clicks[-1]
    parts = [*evidence.salient(place), *evidence.regions(place)]
    masks = [before | part if wanted else before & ~part for part in parts]
    if clicks[0][1]:  # other readings of the first click
        start = clicks[0][0]
        masks += [*evidence.salient(start), *evidence.regions(start)]
    cut = _locally_cut(evidence.pixels, before, place, wanted)
    found = _ranked(evidence, before, clicks, [*masks, cut]) or [Candidate(cut, 0.0)]
    # What lies apart from the click stays as it was: nobody said that it is wrong.
    return [Candidate(_only_at(place, before, one.mask), one.score) for one in found]


def _in_box(evidence: Evidence, box: Box, clicks: Sequence[Click]) -> list[Candidate]:
    """Readings of a box: what fills it and is one thing; all of it where nothing does."""
    (top, left), (bottom, right) = box
    inside = np.zeros(evidence.pixels.shape[:2], dtype=bool)
    inside[top:bottom, left:right] = True
    trimap = np.where(inside, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
    for place, wanted in clicks:
        trimap[place] = cv2.GC_FGD if wanted else cv2.GC_BGD
    masks = [graph_cut(evidence.pixels, trimap, rounds=5)]
    masks += [inside & (one.values > 0.5) for one in evidence.saliences]
    found = []
    for mask in (tidied(one, inside) for one in masks):
        cues = evidence.measure(mask)
        if cues is None or mask.sum() < 0.05 * inside.sum():
            continue
        x, y, across, down = cv2.boundingRect(mask.astype(np.uint8))
        around = np.zeros_like(inside)
        around[y : y + down, x : x + across] = True
        score = overlap(around, inside) * cues.as_part**PART_POWER
        found.append(Candidate(mask, float(score)))
    found = found or [Candidate(inside, 0.0)]
    return sorted(found, key=lambda one: -one.score)


def _ranked(
    evidence: Evidence,
    before: np.ndarray,
    clicks: Sequence[Click],
    masks: Sequence[np.ndarray],
) -> list[Candidate]:
    """Those of `masks` that agree with all clicks, best first."""
    place, wanted = clicks[-1]
    reach = distance_to(before if wanted else ~before)[place] if before.any() else 0.0
    salient = evidence.salient(clicks[0][0]) if clicks[0][1] else []
    found = []
    for mask in masks:
        if not MIN_AREA <= mask.sum() <= MAX_AREA * mask.size:
            continue
        if any(mask[spot] != said for spot, said in clicks):
            continue
        cues = evidence.measure(mask)
        if cues is None:
            continue
        score = _middle(mask ^ before, place, reach) ** MIDDLE_POWER
        score *= (ALONE + cues.as_part) ** PART_POWER
        if before.any():
            score *= overlap(mask, before) ** KEPT_POWER
        score *= _agreement(mask, salient, SALIENCE_POWER)
        found.append(Candidate(mask, float(score)))
    return sorted(found, key=lambda one: -one.score)


def _agreement(mask: np.ndarray, salient: list[np.ndarray], power: float) -> float:
    """How much what stands out agrees with a mask; 1 where nothing does."""
    if not salient:
        return 1.0
    return (ALONE + max(overlap(mask, other) for other in salient)) ** power


def _middle(change: np.ndarray, place: Place, reach: float) -> float:
    """How much a place is the middle of the largest part of a change, in [0, 1].

    A change that fills little of the way from the click to the outline, `reach` [pixels], is not
    worth a click.
    """
    bits = change.astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(bits, connectivity=4)
    here = labels[place]
    if not here:
        return 0.0
    part = np.pad((labels == here).astype(np.uint8), 1)
    depth = cv2.distanceTransform(part, cv2.DIST_L2, 5)[1:-1, 1:-1]
    areas = stats[1:, cv2.CC_STAT_AREA]
    share = stats[here, cv2.CC_STAT_AREA] / areas.max()
    filled = min(1.0, depth[place] / reach) if reach else 1.0
    return float(depth[place] / depth.max() * np.sqrt(filled * share))


def _only_at(place: Place, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """`after` where its change from `before` joins a place, `before` elsewhere."""
    changed = before != after
    labels = cv2.connectedComponents(changed.astype(np.uint8), connectivity=4)[1]
    return np.where((labels == labels[place]) & changed, after, before)


def _locally_cut(
    pixels: np.ndarray, mask: np.ndarray, place: Place, wanted: bool
) -> np.ndarray:
    """Change a mask around a place only, by graph cut within twice its distance to the outline."""
    distance = 0.05 * mask.shape[0]
    if mask.any():
        distance = distance_to(mask if wanted else ~mask)[place]
    rows, columns = np.indices(mask.shape)
    away = np.hypot(rows - place[0], columns - place[1])
    trimap = np.where(mask, cv2.GC_FGD, cv2.GC_BGD).astype(np.uint8)
    trimap[away <= 2 * distance] = cv2.GC_PR_FGD if wanted else cv2.GC_PR_BGD
    trimap[away <= max(1.0, SEED * distance)] = cv2.GC_FGD if wanted else cv2.GC_BGD
    return graph_cut(pixels, trimap, rounds=2)


def component(mask: np.ndarray, place: Place) -> np.ndarray | None:
    """The connected part of a bool mask at a place, small holes filled; None where it is none."""
    if not mask[place]:
        return None
    labels = cv2.connectedComponents(mask.astype(np.uint8))[1]
    part = labels == labels[place]
    return tidied(part, part)
