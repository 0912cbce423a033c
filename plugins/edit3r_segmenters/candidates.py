"""The object that marks describe: candidates are gathered from all that is known, and ranked.

Candidates come from a network that answers marks (a SAM of any kind), from learned salience, and
from regions of like colours. People click somewhere on the object first, then in the middle of what
is wrong. So a candidate counts by how much the click is the middle of what it changes, by how much
the others agree with it, and by how much it is one thing by its colours and outline.
All masks are `[h, w]` at one working size.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np

from edit3r_segmenters.masks import (
    SMALLEST_PART,
    distance_to,
    graph_cut,
    overlap,
    tidied,
)
from edit3r_segmenters.salience import Objectness
from edit3r_segmenters.superpixels import Superpixels
from edit3r_segmenters.surfaces import Surfaces

THRESHOLDS = (0.25, 0.5, 0.75)  # of learned salience, each giving a candidate
MAX_AREA = 0.9  # share of the image above which a region is no object
MIN_AREA = 12  # pixels of a candidate
SEED = (
    0.5  # share of a click's distance to the outline that surely is as the click says
)
ISLAND = 0.2  # share of an answer to one click under which a piece of it is left out
ALIKE = 0.6  # overlap with the best candidate from which another one is a vote on its outline
SURE = 4.0  # logit of what no network has measured
# Powers of what a candidate counts by
MIDDLE_POWER = 2.0
MIDDLE_POWER_FIRST = 0.6  # of a first click that a network answers: it may lie aside
NETWORK_POWER = 1.25  # agreement with the answers to the click
SALIENCE_POWER = 0.5
REGION_POWER = 0.25
PART_POWER = 0.3
KEPT_POWER = 0.25  # how much of the last answer stays
ALONE = 0.1  # agreement that counts for a candidate that nothing agrees with
# Without a network, the colours and the outline have more to say
PART_POWER_ALONE = 0.7
SALIENCE_POWER_ALONE = 1.0
# Where depth bounds the thing: agreement with what a network says of the surfaces at the click
FITTING = 0.7  # overlap of an answer with its surface from which depth tells of the click at all
SAME_BOX = 0.7  # overlap of boxes from which a network says the same of both
AGREED = 0.8  # overlap of answers with the best reading: depth is not asked
HELD = 0.8  # share of a stroke's points that a reading must hold
SAME = 0.85  # overlap of two candidates above which a step from one to the other shows nothing
# Where a mask from another view is completed
MIN_OPEN = 0.2  # share of its rim of which nothing is known
MAX_ASKED = 4  # places at which a network is asked
PART_AGREED = 0.85  # share of an answer's known part that is expected
PART_CONFIRMED = 0.3  # share of all of an answer that is expected
SURELY_AGREED = 0.9  # overlap in what is known from which nothing more is asked
MIN_AGREED = 0.75  # overlap in what is known from which an answer is the object
MIN_SCORE = 0.02  # of the best one's score, under which a candidate is no step either

Place = tuple[int, int]  # row and column
Click = tuple[Place, bool]  # and whether the object is there
Box = tuple[Place, Place]  # first row and column inside, and first ones beyond


class Prompt(Protocol):
    def __call__(
        self, clicks: Sequence[Click], box: Box | None, before: np.ndarray | None = None
    ) -> np.ndarray:
        """Ask a network with clicks, a box, and its answer `before` the last click (logits
        `[h, w]`): logits of several masks `[n, h, w]`.
        """


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
    prompt: Prompt | None = None
    surfaces: Surfaces | None = None

    def regions(self, place: Place) -> list[np.ndarray]:
        """Bool masks of regions at a place, smaller ones first."""
        labels = self.superpixels.labels
        return [row[labels] for row in self.members[self.members[:, labels[place]]]]

    def salient(self, place: Place) -> list[np.ndarray]:
        return [part for one in self.saliences for part in one.parts(place)]


@dataclass(frozen=True, eq=False)
class Candidate:
    """One reading of the marks."""

    logits: np.ndarray  # [h, w] float, > 0 inside
    score: float

    @property
    def mask(self) -> np.ndarray:
        return self.logits > 0


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
        found = [Candidate(_as_logits(prior), 1.0)]
    elif box is not None:
        found = _in_box(evidence, box, clicks)
    elif stroke:
        found = _stroked(evidence, stroke) or _first(evidence, stroke[len(stroke) // 2])
    for number, (place, wanted) in enumerate(clicks):
        if found and found[0].mask[place] == wanted:  # says what is known already
            continue
        done = clicks[: number + 1]
        if found:
            found = _corrected(evidence, found[0].logits, done)
        else:
            found = _first(evidence, place)
    return found


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
    clicks = [(place, True)]
    nothing = np.full(evidence.pixels.shape[:2], -SURE, np.float32)
    logits = [_as_logits(mask) for mask in evidence.salient(place)]
    if evidence.prompt is None:
        logits += [_as_logits(mask) for mask in evidence.regions(place)]
        found = _ranked(evidence, nothing, clicks, logits)
    else:
        asked = list(evidence.prompt(clicks, None))
        logits += asked
        found = _ranked(evidence, nothing, clicks, logits, asked)
        if found:  # it sees better what to do once it is told how far the thing goes
            box = _bounds(found[0].mask)
            boxed = list(evidence.prompt(clicks, box))
            found += _ranked(evidence, nothing, clicks, boxed, asked)
            found.sort(key=lambda one: -one.score)
            if not _is_clear(found[0].mask, asked):
                found = _by_depth(evidence, found, [place], [(box, boxed)])
    if found:
        return _voted(evidence, found, clicks)
    cut = _locally_cut(evidence.pixels, nothing > 0, place, True)
    return [Candidate(_as_logits(cut), 0.0)]


def _stroked(evidence: Evidence, places: Sequence[Place]) -> list[Candidate]:
    """Readings of all places of a stroke at once, in one ranking."""
    clicks = [(place, True) for place in places]
    middle = places[len(places) // 2]
    salient = evidence.salient(middle)
    logits = [_as_logits(mask) for mask in salient]
    votes: list[np.ndarray] = []
    if evidence.prompt is None:
        regions = [mask for place in places for mask in evidence.regions(place)]
        logits += [_as_logits(mask) for mask in regions]
    else:
        whole = list(evidence.prompt(clicks, None))
        alone = [one for click in clicks for one in evidence.prompt([click], None)]
        logits += [*whole, *alone]
        votes = [one > 0 for one in (*whole, *whole, *alone)]
    found = _holding(evidence, logits, places, votes, salient)
    if evidence.prompt is not None and found:
        logits += list(evidence.prompt(clicks, _bounds(found[0].mask)))
        found = _holding(evidence, logits, places, votes, salient)
        found = _by_depth(evidence, found, places[::2])
    return _voted(evidence, found, [])


def _holding(
    evidence: Evidence,
    logits: Sequence[np.ndarray],
    places: Sequence[Place],
    votes: Sequence[np.ndarray],
    salient: Sequence[np.ndarray],
) -> list[Candidate]:
    """Those of `logits` that hold nearly all places, best first."""
    agreements = [(np.mean, votes, NETWORK_POWER), (max, salient, SALIENCE_POWER)]
    part_power = PART_POWER if votes else PART_POWER_ALONE
    found = []
    for one in logits:
        mask = one > 0
        cues = evidence.measure(mask)
        usual = MIN_AREA <= mask.sum() <= MAX_AREA * mask.size
        if cues is None or not usual or not _holds(mask, places):
            continue
        score = (ALONE + cues.as_part) ** part_power
        score *= _agreement(mask, [one for one in agreements if one[1]])
        found.append(Candidate(one, float(score)))
    return sorted(found, key=lambda one: -one.score)


def _holds(mask: np.ndarray, places: Sequence[Place]) -> bool:
    """Whether a bool mask holds nearly all places."""
    return bool(np.mean([mask[place] for place in places]) >= HELD)


def _is_clear(best: np.ndarray, asked: Sequence[np.ndarray]) -> bool:
    """Whether a network's answers to a click all mean the best reading, near or far."""
    return float(np.mean([overlap(best, one > 0) for one in asked])) >= AGREED


def _by_depth(
    evidence: Evidence,
    found: list[Candidate],
    places: Sequence[Place],
    answered: Sequence[tuple[Box, Sequence[np.ndarray]]] = (),
) -> list[Candidate]:
    """The candidates in the order that depth gives them; as they are where it says nothing.

    A network is asked with a place and the box of each surface there, unless it `answered` nearly
    the same box before. An answer counts by how well it fits the surface; a candidate by how well
    it agrees with these answers, and by how much it stands before what is beside it.
    """
    surfaces, prompt = evidence.surfaces, evidence.prompt
    if surfaces is None or prompt is None or not found:
        return found
    fits, answers = [], []
    for place in places:
        known = list(answered)
        for surface in surfaces.at(place):
            box = _bounds(surface)
            alike = [said for other, said in known if _shared(box, other) >= SAME_BOX]
            if not alike:
                alike = [list(prompt([(place, True)], box))]
                known.append((box, alike[0]))
            said = [one > 0 for one in alike[0]]
            answers.append(said)
            fits.append(max(overlap(surface, one) for one in said))
    if max(fits, default=0.0) < FITTING:
        return found
    weights = np.square(fits)
    judged = []
    for one in found:
        best = [max(overlap(one.mask, other) for other in said) for said in answers]
        factor = ALONE + float(np.average(best, weights=weights))
        factor *= ALONE + surfaces.before(one.mask)
        judged.append(Candidate(one.logits, one.score * factor))
    return sorted(judged, key=lambda one: -one.score)


def _corrected(
    evidence: Evidence, before: np.ndarray, clicks: Sequence[Click]
) -> list[Candidate]:
    """Readings of all clicks, given the answer `before` the last of them (logits).

    The part at the click is added or taken away; or all clicks are asked for anew.
    """
    place, wanted = clicks[-1]
    masks = [*evidence.salient(place), *evidence.regions(place)]
    parts = [_as_logits(mask) for mask in masks]
    wholes: list[np.ndarray] = []
    if evidence.prompt is not None:
        parts += list(evidence.prompt([(place, True)], None))
        wholes += list(evidence.prompt(clicks, None))
        wholes += list(evidence.prompt(clicks, None, before))
        wholes += list(evidence.prompt(clicks, _bounds(before > 0)))
    if wanted:
        logits = [np.maximum(before, part) for part in parts]
    else:
        logits = [np.minimum(before, -part) for part in parts]
    for whole in wholes:
        logits += [whole, _only_at(place, before, whole)]
    if evidence.prompt is None and clicks[0][1]:  # other readings of the first click
        start = clicks[0][0]
        others = [*evidence.salient(start), *evidence.regions(start)]
        logits += [_as_logits(mask) for mask in others]
    cut = _as_logits(_locally_cut(evidence.pixels, before > 0, place, wanted))
    found = _ranked(evidence, before, clicks, [*logits, cut], wholes)
    found = _voted(evidence, found, clicks) or [Candidate(cut, 0.0)]
    # What lies apart from the click stays as it was: nobody said that it is wrong.
    return [Candidate(_only_at(place, before, one.logits), one.score) for one in found]


def _in_box(evidence: Evidence, box: Box, clicks: Sequence[Click]) -> list[Candidate]:
    """Readings of a box: what fills it and is one thing; all of it where nothing does."""
    (top, left), (bottom, right) = box
    inside = np.zeros(evidence.pixels.shape[:2], dtype=bool)
    inside[top:bottom, left:right] = True
    if evidence.prompt is not None:
        said = [(place, wanted) for place, wanted in clicks if inside[place]]
        logits = list(evidence.prompt(said, box))
    else:
        trimap = np.where(inside, cv2.GC_PR_FGD, cv2.GC_BGD).astype(np.uint8)
        for place, wanted in clicks:
            trimap[place] = cv2.GC_FGD if wanted else cv2.GC_BGD
        masks = [graph_cut(evidence.pixels, trimap, rounds=5)]
        masks += [inside & (one.values > 0.5) for one in evidence.saliences]
        logits = [_as_logits(tidied(mask, inside)) for mask in masks]
    found = []
    for one in logits:
        mask = one > 0
        cues = evidence.measure(mask)
        if cues is None or mask.sum() < 0.05 * inside.sum():
            continue
        (row, column), (last_row, last_column) = _bounds(mask)
        around = np.zeros_like(inside)
        around[row:last_row, column:last_column] = True
        score = overlap(around, inside) * cues.as_part**PART_POWER_ALONE
        found.append(Candidate(one, float(score)))
    found = found or [Candidate(_as_logits(inside), 0.0)]
    return sorted(found, key=lambda one: -one.score)


def _ranked(
    evidence: Evidence,
    before: np.ndarray,
    clicks: Sequence[Click],
    logits: Sequence[np.ndarray],
    asked: Sequence[np.ndarray] = (),
) -> list[Candidate]:
    """Those of `logits` that agree with all clicks, best first; `asked` are a network's answers."""
    place, wanted = clicks[-1]
    mask = before > 0
    reach = distance_to(mask if wanted else ~mask)[place] if mask.any() else 0.0
    agreements, middle_power = [], MIDDLE_POWER
    if evidence.prompt is None:
        salient = evidence.salient(clicks[0][0])
        if salient and clicks[0][1]:
            agreements = [(max, salient, SALIENCE_POWER_ALONE)]
    elif not mask.any():
        agreements = _agreements(evidence, place, [one > 0 for one in asked])
        middle_power = MIDDLE_POWER_FIRST
    part_power = PART_POWER if asked else PART_POWER_ALONE
    found = []
    for one in logits:
        inside = one > 0
        if not MIN_AREA <= inside.sum() <= MAX_AREA * inside.size:
            continue
        if any(inside[spot] != said for spot, said in clicks):
            continue
        cues = evidence.measure(inside)
        if cues is None:
            continue
        score = _middle(inside ^ mask, place, reach) ** middle_power
        score *= (ALONE + cues.as_part) ** part_power
        if mask.any():
            score *= overlap(inside, mask) ** KEPT_POWER
        score *= _agreement(inside, agreements)
        found.append(Candidate(one, float(score)))
    return sorted(found, key=lambda one: -one.score)


def _voted(
    evidence: Evidence, found: list[Candidate], clicks: Sequence[Click]
) -> list[Candidate]:
    """The candidates behind what those like the best say of each pixel together, by their scores:
    one's crumbs and gaps are not another's. Regions without a network gain nothing by it.
    """
    if not found or evidence.prompt is None:
        return found
    best = found[0]
    alike = [one for one in found if overlap(one.mask, best.mask) >= ALIKE]
    votes = sum(one.score * np.sign(one.logits) for one in alike)
    # What lies apart from what was clicked on is rarely meant; further clicks add it.
    smallest = ISLAND if len(clicks) <= 1 else SMALLEST_PART
    inside = tidied(votes > 0, votes > 0, smallest)
    if any(inside[place] != wanted for place, wanted in clicks):
        return found
    share = SURE * votes / sum(one.score for one in alike)
    logits = np.where(inside == (votes > 0), share, _as_logits(inside))
    return [Candidate(logits.astype(np.float32), best.score), *found]


def _agreements(evidence: Evidence, place: Place, asked: list[np.ndarray]) -> list:
    """Masks that a candidate should agree with: which of them counts, and with what power."""
    salient = evidence.salient(place)
    agreements = [(np.mean, asked, NETWORK_POWER)]
    if salient:
        agreements.append((max, salient, SALIENCE_POWER))
    regions = evidence.regions(place)
    if regions:
        agreements.append((max, regions, REGION_POWER))
    return agreements


def _agreement(mask: np.ndarray, agreements: list) -> float:
    """How much a mask agrees with the others, by what `_agreements` says of them."""
    score = 1.0
    for pick, others, power in agreements:
        agreed = pick([overlap(mask, other) for other in others])
        score *= (ALONE + agreed) ** power
    return score


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
    changed = (before > 0) != (after > 0)
    labels = cv2.connectedComponents(changed.astype(np.uint8), connectivity=4)[1]
    return np.where((labels == labels[place]) & changed, after, before)


def _as_logits(mask: np.ndarray) -> np.ndarray:
    return np.where(mask, SURE, -SURE).astype(np.float32)


def _bounds(mask: np.ndarray) -> Box:
    rows, columns = np.nonzero(mask)
    first = (int(rows.min()), int(columns.min()))
    return first, (int(rows.max()) + 1, int(columns.max()) + 1)


def _shared(one: Box, other: Box) -> float:
    """Intersection over union of two boxes."""
    first, last = np.maximum(one[0], other[0]), np.minimum(one[1], other[1])
    both = np.prod(np.maximum(last - first, 0))
    areas = sum(np.prod(np.subtract(box[1], box[0])) for box in (one, other))
    return float(both / (areas - both))


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
