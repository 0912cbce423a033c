"""The selector `by-segmenter`: a segmenter's answers on each photo, carried to the others.

Marks on one view are enough: the mask found there is carried to the other views by the scene's own
geometry where it is at hand, else by what the pictures show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor

import edit3r
from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.instructions import EVERY
from edit3r.contract.interfaces import (
    ASK,
    BACKGROUND,
    SURE,
    Box,
    Geometry,
    Marks,
    Proposal,
    Reading,
    Segmenter,
    Selected,
    Selection,
    Selector,
    Tracks,
)
from edit3r.contract.reporting import note, say, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import Views
from edit3r.kit.cache import fingerprint
from edit3r.kit.geometry.maps import shown
from edit3r.kit.geometry.warping import nearest_views, surfaces_apart, warp
from edit3r_select.agreeing import (
    CARRIED,
    EXACT,
    FOUND,
    ONE_SURFACE,
    Told,
    agreed,
    of_itself,
    told_by,
)
from edit3r_select.answering import SummingSegmenter
from edit3r_select.confirming import ASKED, surest
from edit3r_select.obeying import (
    SAME_SURFACE,
    Point,
    obeyed,
    points_of,
    seen_elsewhere,
)
from edit3r_select.which import pick

# of an object's pixels that must lie in another view for geometry to say where it is there
MIN_SHARE = 0.2
FAINT = 0.01  # a probability below this is none: such pixels keep their exact values
MIN_AREA = 2e-4  # share of a view under which a carried mask shows nothing
ALSO = 0.5  # the same for one of several beside one that is sure
FOUND_AT_ALL = 0.05  # confidence under which words found as good as nothing
CLICKED_SURE = 0.25  # the same where a click lies on what they found
SAME_THING = 0.4  # overlap from which a click and words mean one thing
SAME_READING = 0.85  # overlap from which two readings are one
INSIDE = 0.95  # share of a part that lies inside of its whole, at least
MAX_READINGS = 3  # that are shown
SPANS = 0.7  # share of a side of a photo along which a thing goes on beyond it
VOTES = 6  # photos near a view that say what of it belongs to the thing


class SegmenterSelector(Selector):
    """What a segmenter answers for the marks on a photo, carried to all photos."""

    class Settings(edit3r.Settings):
        segmenter: PartChoice = Field(
            PartChoice(name="auto"), description="answers marks and words on one photo"
        )

    settings: Settings

    def __init__(self, settings: Settings, segmenter: Segmenter) -> None:
        self.settings, self.segmenter = settings, segmenter

    def select(
        self, views: Views, selection: Selection, geometry: Geometry | None = None
    ) -> Selected:
        return select_masks(
            views.images[0], selection, self.segmenter, geometry, views.intrinsics
        )


def select_masks(
    images: Float[Tensor, "view 3 height width"],
    selection: Selection,
    segmenter: Segmenter,
    geometry: Geometry | None = None,
    intrinsics: Float[Tensor, "1 view 3 3"] | None = None,
) -> Selected:
    """Find the chosen object on every view.

    `geometry` (batch 1) and `intrinsics` are those of the same views; without them masks are
    carried by pictures alone. Raises InputError for marks outside the photos, and for words that
    `segmenter` does not know or find, unless `selection.guess` allows a guess; with
    `selection.sure` also for what words found unsurely.
    """
    _check(selection, len(images))
    work = _Work(images, selection, segmenter, geometry, intrinsics)
    if not selection.says_where:
        work.look_up(selection.views[0] if selection.views else 0)
    # a thing is found again on other photos, all else is not
    all_else = selection.words == BACKGROUND and not selection.says_where
    if all_else:
        work.masks = {view: 1 - mask for view, mask in work.masks.items()}
    for view in selection.views:
        work.mark(view)
    for view in range(len(images)):
        if view not in work.masks:
            work.carry(view)
    work.agree()
    for view in range(len(images)):
        work.obey(view)
    how = tuple(work.how[view] for view in range(len(images)))
    masks = torch.stack([work.masks[view] for view in range(len(images))])[:, None]
    note(
        "selection",
        {
            "points": selection.positive,
            "not": selection.negative,
            "boxes": selection.boxes,
            "regions": selection.regions,
            "how": how,
        },
    )
    masks = grown(masks, -selection.grow if all_else else selection.grow)
    if selection.inverted != all_else:
        work.tell_empty(masks)
        masks = (1 - masks) * shown(masks)
    for text in work.warnings:
        warn(text)
    return Selected(
        masks,
        how,
        tuple(work.warnings),
        work.confidence,
        tuple(work.readings),
        selection.reading,
    )


def grown(
    masks: Float[Tensor, "view 1 height width"], pixels: float
) -> Float[Tensor, "view 1 height width"]:
    """Soft masks with their outline moved outwards, inwards where `pixels` is negative; the soft
    edge moves along.
    """
    if not pixels:
        return masks
    reach = int(np.ceil(abs(pixels)))
    rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    disc = (np.hypot(rows, columns) <= abs(pixels) + 0.25).astype(np.uint8)
    move = cv2.dilate if pixels > 0 else cv2.erode
    moved = [move(mask.numpy(force=True), disc) for mask in masks[:, 0]]
    return torch.from_numpy(np.stack(moved))[:, None].to(masks)


def filled(box: Box, size: Sequence[int]) -> Float[Tensor, "height width"]:
    """A mask of 1 in a box [shares of the sides], 0 elsewhere."""
    height, width = size
    left, top, across, down = box
    mask = torch.zeros(height, width)
    rows = slice(round(top * height), round((top + down) * height))
    columns = slice(round(left * width), round((left + across) * width))
    mask[rows, columns] = 1
    return mask


def _check(selection: Selection, count: int) -> None:
    """Marks lie on views that exist, and masks are made of numbers."""
    for view, mask in selection.masks.items():
        if not torch.isfinite(mask).all():
            raise InputError(
                f"the mask of photo {view + 1} has values that are no numbers."
            )
    outside = [view for view in selection.views if not 0 <= view < count]
    if outside:
        raise InputError(
            f"photo {outside[0] + 1} is marked, but there are {count} photos."
        )


class _Work:
    """One call of `select_masks`: masks found so far, and where each comes from."""

    def __init__(
        self,
        images: Float[Tensor, "view 3 height width"],
        selection: Selection,
        segmenter: Segmenter,
        geometry: Geometry | None,
        intrinsics: Float[Tensor, "1 view 3 3"] | None,
    ) -> None:
        self.images, self.selection = images, selection
        self.segmenter = SummingSegmenter(segmenter)
        self.geometry = geometry
        self.intrinsics = (
            intrinsics
            if geometry is None or geometry.intrinsics is None
            else geometry.intrinsics
        )
        self.places: _Hashed | None = None  # once they are asked for
        self.masks: dict[int, Tensor] = {}
        self.how: dict[int, str] = {}
        # by view of the mask and direction
        self.tracks: dict[tuple[int, int], Tracks] = {}
        self.warnings: list[str] = []
        self.confidence: float | None = None  # of what the words named
        self.least = SURE  # confidence from which words find it on another photo too
        self.readings: list[Reading] = []
        self.by_name: set[int] = set()  # views on each of which several were looked for

    def look_up(self, view: int) -> None:
        """The mask of what the words name, or of what stands out where a guess is allowed."""
        words, guess = self.selection.words, self.selection.guess
        found = None
        if words:
            view, found = self._named_on(view)
            if found is not None:
                found = tuple(one for one in found if one.confidence >= FOUND_AT_ALL)
        elif self.selection.which:  # "the big one" may be one of anything
            proposals = self.segmenter.propose(self.images[view])
            found = tuple(replace(one, confidence=SURE / 2) for one in proposals)
        if found:
            self._take_named(view, found)
            return
        if not guess:
            raise InputError(self._why_not(view, known=found is not None))
        proposals = self.segmenter.propose(self.images[view])
        if not proposals:
            raise InputError(f"nothing stands out on photo {view + 1}; {ASK}.")
        self._keep(view, proposals[0].soft_mask, "guess")
        self.warnings.append(
            f"what stands out most on photo {view + 1} is taken, which is a guess; to be sure, "
            f"{ASK}."
        )

    def _named_on(self, view: int) -> tuple[int, tuple[Proposal, ...] | None]:
        """The photo on which the words are found, and what they name there.

        Others than the first are asked where that one is not sure; which is the left one is said
        of the first.
        """
        words = self.selection.words
        found = self.segmenter.segment_text(self.images[view], words)
        if found is None or self.selection.which:
            return view, found
        if found and found[0].confidence >= SURE:
            return view, found
        asked = {view: found}
        for other in [one for one in range(len(self.images)) if one != view][
            : ASKED - 1
        ]:
            there = self.segmenter.segment_text(self.images[other], words)
            asked[other] = there or ()
        return surest(asked, view, self._shared)

    def _take_named(self, view: int, found: tuple[Proposal, ...]) -> None:
        """The mask of those of `found` that are meant. Raises InputError for an unsure one where
        only sure ones may be taken.
        """
        words, which = self.selection.words, self.selection.which
        alike = () if which else self._also(found)
        several = alike if self.selection.several else ()
        picked = several or pick(found, which, self.images[view])
        sure = [one.confidence for one in picked if one.confidence >= SURE]
        self.confidence = min(sure if several else [one.confidence for one in picked])
        self.least = min(SURE, self.confidence)
        if not several and len(alike) > 1:
            self.confidence /= len(alike)  # nothing says which of them is meant
            self.warnings.append(
                f"{len(alike)} things on photo {view + 1} may be {words!r}, and the likeliest is "
                f"taken; say which is meant ('the left {words}')."
            )
        named = " ".join((*which, words)).strip()
        if len(picked) > 1:
            say("selection.several", f"{len(picked)} {words} on photo {view + 1}")
        if self.confidence < SURE and self.selection.sure:
            raise InputError(
                f"{named!r} was found on photo {view + 1}, but it may be something else "
                f"(confidence {self.confidence:.0%}, {SURE:.0%} are needed); {ASK}, or leave "
                "out --sure to take it."
            )
        masks = [self._stepped(view, proposal) for proposal in picked]
        mask = torch.stack(masks).amax(0)
        if self.confidence < SURE and not self.selection.larger:
            mask = self._read_among(view, self._readings_of_words(view, picked, found))
            self._tell_doubt(view, named)
        elif self.confidence < 1:
            say("selection.words", f"{named}: found, confidence {self.confidence:.0%}")
        self._keep(view, mask, "words")
        every = several or bool(set(which) & EVERY)
        if words != BACKGROUND and not which and self.confidence >= SURE:
            # beyond the border it has parts that another photo shows
            every = every or _spans(mask > 0.5)
        if every and not self.selection.larger and self.selection.reading == 1:
            self._look_on_others(view)

    def _look_on_others(self, first: int) -> None:
        """Several are looked for on every photo, as surely as on the first: people walk, and a
        photo shows what another does not.
        """
        for view in range(len(self.images)):
            if view == first or view in self.masks:
                continue
            found = self.segmenter.segment_text(self.images[view], self.selection.words)
            found = tuple(found or ())
            likely = [one for one in found if one.confidence >= self.least]
            alike = [one.soft_mask for one in self._also(found) or likely]
            if alike:
                self._keep(view, torch.stack(alike).amax(0), "words")
                self.by_name.update((first, view))

    def _also(self, found: tuple[Proposal, ...]) -> tuple[Proposal, ...]:
        """Those that are sure, and others that are likely beside them; none where none is sure."""
        if all(one.confidence < SURE for one in found):
            return ()
        return tuple(one for one in found if one.confidence >= ALSO)

    def _tell_doubt(self, view: int, named: str) -> None:
        others = [one.number for one in self.readings]
        others.remove(min(self.selection.reading, len(others)))
        flags = " or ".join(f"--reading {number}" for number in others)
        self.warnings.append(
            f"{named!r} was found on photo {view + 1} with a confidence of only "
            f"{self.confidence:.0%}: look at its outline. "
            f"To correct it{f', take {flags}, or' if flags else ':'} {ASK}."
        )

    def _readings_of_words(
        self, view: int, picked: tuple[Proposal, ...], found: tuple[Proposal, ...]
    ) -> list[tuple[Tensor, float]]:
        """What unsure words may mean: what was picked, others of that name, more or less of it."""
        masks = [torch.stack([one.soft_mask for one in picked]).amax(0)]
        scores = [min(one.confidence for one in picked)]
        height, width = self.images.shape[-2:]
        x, y, across, down = picked[0].box
        others = list(found)
        if across and down:
            box = (x / width, y / height, across / width, down / height)
            boxed = self.segmenter.readings(self.images[view], Marks(box=box))
            others += [
                replace(one, confidence=one.confidence * scores[0]) for one in boxed
            ]
        for one in others:
            if all(_overlap(one.soft_mask, mask) < SAME_READING for mask in masks):
                masks.append(one.soft_mask)
                scores.append(one.confidence)
        return list(zip(masks, scores))[:MAX_READINGS]

    def _read_among(self, view: int, options: list[tuple[Tensor, float]]) -> Tensor:
        """The reading of that number among all, which are kept; the last where it has none."""
        self.readings = [
            Reading(view, mask, float(score), number)
            for number, (mask, score) in enumerate(options, 1)
        ]
        wanted = self.selection.reading
        if wanted > len(options):
            self.warnings.append(
                f"--reading {wanted}: there are {len(options)}; the last one is taken."
            )
        return options[min(wanted, len(options)) - 1][0]

    def _stepped(self, view: int, proposal: Proposal) -> Float[Tensor, "height width"]:
        """The mask of a named thing; a larger or smaller reading of its box where that is asked."""
        if not self.selection.larger:
            return proposal.soft_mask
        height, width = self.images.shape[-2:]
        x, y, across, down = proposal.box
        box = (x / width, y / height, across / width, down / height)
        marks = Marks(box=box, larger=self.selection.larger)
        return self.segmenter.segment_marks(self.images[view], marks).soft_mask

    def _why_not(self, view: int, known: bool) -> str:
        """Why the words found nothing, and what to do."""
        words = self.selection.words
        if not words:
            return f"nothing says which object is meant; {ASK}."
        guess = "add --guess to take what stands out most"
        if known:
            return f"{words!r} was not found on photo {view + 1}; {ASK}, or {guess}."
        name = component_name(self.segmenter.asked)
        more = self.segmenter.words_help() or (
            "use a segmenter that reads words (edit3r list-plugins --kind segmenter)"
        )
        return f"{words!r} is not a word that segmenter {name!r} knows; {ASK}, {more}, or {guess}."

    def mark(self, view: int) -> None:
        """The mask of a view that carries marks; what other views showed so far is where it is
        expected.
        """
        chosen = self.selection
        if view in chosen.masks:
            self._keep(view, chosen.masks[view], "given")
        else:
            if view not in self.masks and self.masks:
                told = len(self.warnings)
                self.carry(view)
                # that it was not found here is what the marks are for
                del self.warnings[told:]
            prior = self.masks.get(view)
            expected = (
                prior is not None
                and view not in chosen.boxes
                and bool((prior > 0.5).any())
            )
            marks = replace(
                chosen.marks_on(view),
                prior=prior if expected else None,
                larger=chosen.larger,
            )
            if marks.inside or marks.box is not None or (marks.negative and expected):
                self._keep(view, self._described(view, marks), "marked")
            elif view in {on for on, _ in chosen.regions} and not expected:
                self._keep(view, torch.zeros_like(self.images[view, 0]), "region")
            elif view in chosen.added or expected:  # what is painted is taken exactly
                self._keep(
                    view,
                    torch.zeros_like(self.images[view, 0]) if prior is None else prior,
                    "marked",
                )
            else:
                raise InputError(
                    f"photo {view + 1} is only told what is not the object; {ASK} on it."
                )
        self._paint(view)

    def agree(self) -> None:
        """Let photos that show one surface agree about patches of it: those nearest to a photo, and
        those with masks of their own, say something of it.
        """
        own, exact, before = self._own(), self._exact(), {}
        if self.geometry is None or exact >= self.how.keys():
            return
        for view, how in self.how.items():
            if how not in ("pictures", "not found") and view not in self.by_name:
                weight = FOUND if view in own else CARRIED
                weight = EXACT if view in exact else weight
                before[view] = of_itself(self.masks[view], weight)
        near = nearest_views(self.geometry.c2w, self.geometry.depths, VOTES)
        for view, mine in before.items():
            if mine.weight == EXACT:
                continue
            asked = [one for one in dict.fromkeys((*own, *near[view])) if one != view]
            others = [self._told(view, one, before) for one in asked]
            said = [one for one in others if one is not None]
            if said:
                self.masks[view] = agreed(mine, said)
                self._paint(view)

    def _told(self, view: int, source: int, masks: Mapping[int, Told]) -> Told | None:
        """What another photo says of a view; None where it shows nothing of it."""
        shared = self._shared(view, source, ONE_SURFACE) if source in masks else None
        if shared is None:
            return None
        assert self.geometry is not None
        confidence = self.geometry.confidence[0, [view, source]]
        return told_by(masks[source], shared, confidence)

    def _paint(self, view: int) -> None:
        """Brush, exact boxes and eraser are taken as they are."""
        mask, chosen = self.masks[view], self.selection
        for box in (box for on, box in chosen.regions if on == view):
            mask = torch.maximum(mask, filled(box, mask.shape).to(mask))
        if view in chosen.added:
            mask = torch.maximum(mask, chosen.added[view].to(mask))
        if view in chosen.removed:
            mask = mask * (1 - chosen.removed[view].to(mask))
        self.masks[view] = mask

    def obey(self, view: int) -> None:
        """Hold the mask of a view to all points that it shows, its own last."""
        points: list[Point] = []
        geometry, lens = self.geometry, self.intrinsics
        for source in self.selection.views:
            marks = points_of(self.selection.marks_on(source))
            if source != view and geometry is not None and lens is not None:
                points += seen_elsewhere(marks, geometry, lens, (source, view))
        points += points_of(self.selection.marks_on(view))
        if points:
            self.masks[view] = obeyed(
                self.images[view], self.masks[view], points, self.segmenter
            )
            self._paint(view)

    def _described(self, view: int, marks: Marks) -> Float[Tensor, "height width"]:
        """The object that marks describe.

        A click says where, and words say how far: a click on a wheel beside the word "bike" means
        the bike.
        """
        named = self._named_at(view, marks)
        found = self._likely(view, marks, named)
        if self.selection.reading > 1:
            return found
        if named is None or _overlap(found, named) >= SAME_THING:
            return found
        say("selection.clicked", f"what is clicked on is {self.selection.words}")
        self.readings = []
        points = points_of(marks)
        inside = [bool(_at(named, point.place) > 0.5) for point in points]
        if inside == [point.wanted for point in points]:
            return named
        marks = replace(marks, prior=named)
        return self.segmenter.segment_marks(self.images[view], marks).soft_mask

    def _likely(
        self, view: int, marks: Marks, named: Tensor | None
    ) -> Float[Tensor, "height width"]:
        """The reading of the marks that is asked for; what the words name is one, as likely as
        the first, and comes before a larger one: a fox before the fox with its plaque.
        """
        image = self.images[view]
        if marks.larger or marks.prior is not None:
            return self.segmenter.segment_marks(image, marks).soft_mask
        found = self.segmenter.readings(image, marks)
        if self.readings:  # another view was marked before, and says which
            return found[0].soft_mask
        options = [(one.soft_mask, one.confidence) for one in found[:MAX_READINGS]]
        if named is not None:
            same = [_overlap(named, mask) >= SAME_READING for mask, _ in options]
            if not any(same):
                options.append((named, options[0][1]))
            elif _within(options[same.index(True)][0], options[0][0]):
                options.insert(0, options.pop(same.index(True)))
        return self._read_among(view, options)

    def _named_at(
        self, view: int, marks: Marks
    ) -> Float[Tensor, "height width"] | None:
        """What the words name where the first click lies; None without words, or where a box,
        another view or the user's steps say more.
        """
        words = self.selection.words
        more = marks.box is not None or marks.prior is not None or marks.larger != 0
        if not words or not marks.positive or more:
            return None
        for one in self.segmenter.segment_text(self.images[view], words) or ():
            clicked = _at(one.soft_mask, marks.positive[0]) > 0.5
            if clicked and one.confidence >= CLICKED_SURE:
                return one.soft_mask
        return None

    def carry(self, view: int) -> None:
        """The mask of a view without marks, from the nearest view that has one of its own."""
        source = min(self._own(), key=lambda other: abs(other - view))
        if not (self.masks[source] > 0.5).any():  # an empty mask is carried as it is
            self._keep(view, self.masks[source], "pictures")
            return
        expected = self._by_geometry(view)
        if expected is not None:
            found = self.segmenter.segment_marks(self.images[view], expected).soft_mask
            self._keep(view, found, "geometry")
            return
        logits = self._followed(source, view)
        there = bool((logits > 0).any())
        if not there and self._named_again(view):
            return
        self._keep(view, logits.sigmoid() * there, "pictures" if there else "not found")
        if not there:
            self.warnings.append(
                f"the object was not found again on photo {view + 1}, which stays as it is; "
                "click on it there."
            )

    def _named_again(self, view: int) -> bool:
        """Whether what words found elsewhere, as surely, is found by them on this photo too."""
        if self.confidence is None or self.selection.which or self.selection.larger:
            return False
        words = self.selection.words
        found = self.segmenter.segment_text(self.images[view], words) or ()
        likely = [one for one in found if one.confidence >= self.least]
        if likely:
            self._keep(view, likely[0].soft_mask, "words")
        return bool(likely)

    def _own(self) -> list[int]:
        """Views whose masks were not carried from another one."""
        carried = ("geometry", "pictures", "not found")
        return [view for view, how in self.how.items() if how not in carried]

    def _exact(self) -> set[int]:
        """Views whose masks are taken as they are: given, painted or a box to the pixel."""
        given = {view for view, how in self.how.items() if how in ("given", "region")}
        return given | set(self.selection.added)

    def tell_empty(self, masks: Float[Tensor, "view 1 height width"]) -> None:
        """Say which photos stay as they are because nothing is selected there."""
        for view, some in enumerate(shown(masks).flatten().tolist()):
            if not some and self.how[view] != "not found":  # that was said
                self.warnings.append(
                    f"nothing is selected on photo {view + 1}, so all but that is nothing: it "
                    "stays as it is."
                )

    def _followed(self, source: int, view: int) -> Float[Tensor, "height width"]:
        """Logits of the object of `source`, followed through all views on the way to `view`."""
        step = 1 if view > source else -1
        if (source, step) not in self.tracks:
            way = list(range(source, len(self.images) if step > 0 else -1, step))
            self.tracks[source, step] = self.segmenter.track(
                self.images[way], self.masks[source][None]
            )
        tracks, place = self.tracks[source, step], abs(view - source)
        logits = tracks.logits[place, 0]
        there = bool(tracks.present[place, 0])
        return logits if there else logits.clamp(max=-1e-3)

    def _by_geometry(self, view: int) -> Marks | None:
        """Where the views with masks say that the object is; None where geometry cannot tell.

        The views with own masks are asked first, then those that geometry carried it to: of what
        they all do not see, nothing is known.
        """
        carried = [other for other, how in self.how.items() if how == "geometry"]
        expected = torch.zeros_like(self.images[view, 0])
        known = torch.zeros_like(expected, dtype=torch.bool)
        needed = float("inf")
        for source in (*self._own(), *carried):
            surface = self._shared(view, source)
            if surface is None or not (self.masks[source] > 0.5).any():
                continue
            grid, same = surface
            moved = warp(self.masks[source][None], grid, padding="zeros")[0]
            expected = torch.where(same & ~known, moved, expected)
            known |= same
            needed = min(needed, MIN_SHARE * float((self.masks[source] > 0.5).sum()))
        least = max(needed, MIN_AREA * expected.numel())
        if float((expected > 0.5).sum()) < least:
            return None
        return Marks(prior=expected, known=known)

    def _shared(
        self, view: int, source: int, tolerance: float = SAME_SURFACE
    ) -> tuple[Tensor, Tensor] | None:
        """Where the pixels of `view` lie in `source`, and whether both show one surface."""
        geometry, pair = self.geometry, [view, source]
        if geometry is None or self.intrinsics is None:
            return None
        if not geometry.registered[0, pair].all():
            return None
        if self.places is None:
            photos = geometry.depths[0], self.intrinsics[0], geometry.c2w[0]
            self.places = _Hashed(fingerprint(photos), photos)
        grid, apart = _apart(self.places, *pair)
        return grid, apart < tolerance

    def _keep(self, view: int, mask: Tensor, how: str) -> None:
        mask = mask.to(self.images).clamp(0, 1)
        self.masks[view], self.how[view] = torch.where(mask < FAINT, 0, mask), how


@dataclass(frozen=True)
class _Hashed:
    """Depths, intrinsics and poses of all views, compared by their fingerprint alone."""

    fingerprint: str
    photos: tuple[Tensor, Tensor, Tensor] = field(compare=False)


@lru_cache(maxsize=24)
def _apart(places: _Hashed, view: int, source: int) -> tuple[Tensor, Tensor]:
    """Clicks follow each other on the same photos."""
    return surfaces_apart(*(one[[view, source]] for one in places.photos))


def _at(
    mask: Float[Tensor, "height width"], place: tuple[float, float]
) -> Float[Tensor, ""]:
    """The value of a mask at x and y in [0, 1]."""
    height, width = mask.shape
    column, row = int(place[0] * width), int(place[1] * height)
    return mask[min(row, height - 1), min(column, width - 1)]


def _spans(inside: Bool[Tensor, "height width"]) -> bool:
    sides = (inside[0], inside[-1], inside[:, 0], inside[:, -1])
    return max(float(side.double().mean()) for side in sides) > SPANS


def _overlap(
    one: Float[Tensor, "height width"], other: Float[Tensor, "height width"]
) -> float:
    """Intersection over union of two soft masks."""
    one, other = one > 0.5, other > 0.5
    return float((one & other).sum() / (one | other).sum().clamp(min=1))


def _within(
    part: Float[Tensor, "height width"], whole: Float[Tensor, "height width"]
) -> bool:
    """Whether nearly all of a soft mask lies inside another one."""
    part, whole = part > 0.5, whole > 0.5
    return float((part & whole).sum()) >= INSIDE * float(part.sum())
