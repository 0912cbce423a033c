"""What words name on photos, and what stands out where they name nothing."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import torch

from edit3r import default_registry
from edit3r.contract.component import component_name
from edit3r.contract.errors import InputError
from edit3r.contract.instructions import EVERY
from edit3r.contract.interfaces import (
    ASK,
    BACKGROUND,
    SURE,
    Box,
    Candidate,
    Proposal,
    Segmenter,
    Selection,
    candidate_flags,
)
from edit3r.contract.reporting import say, warn
from edit3r.kit import asking
from edit3r.kit.geometry.warping import warp
from edit3r.kit.segmenting import automatic_masks
from edit3r.kit.weights.find import at_hand
from edit3r_select.answering import Image, answered, standing_out, subject_of
from edit3r_select.marks import Marks
from edit3r_select.photos import Mask, Named, OnPhoto, Photos, overlap
from edit3r_select.ranking import SAME
from edit3r_select.which import pick

ASKED = 3  # photos on which an unsure word is looked for, at most
FOUND_AT_ALL = 0.05  # confidence under which words found as good as nothing
GUESSED = 0.25  # of what stands out where words mean nothing: it is a question
ALSO = 0.5  # confidence from which one of several is taken beside a sure one
SURER = 1.2  # how many times as sure another photo must be to be taken in place of the first
SEES = 0.5  # share of a mask that a photo must show to say anything of it
UNCONFIRMED = (
    0.5  # what is left of a confidence where a photo sees the place, but no such thing
)
SAME_THING = 0.4  # overlap from which two findings are one thing
SPANS = 0.7  # share of a side of a photo along which a thing goes on beyond it
MAX_CANDIDATES = 3  # that are shown

Proposals = tuple[Proposal, ...]


def looked_up(photos: Photos, selection: Selection) -> Named:
    """What the words of a selection mean; what stands out, as a question, where nobody knows them
    or finds it.
    """
    named = _named(photos, selection)
    if named.confidence is not None and SURE <= named.confidence < 1:
        what = " ".join((*selection.qualifiers, selection.words)).strip()
        say("selection.words", f"{what}: found, confidence {named.confidence:.0%}")
    return named


def _named(photos: Photos, selection: Selection) -> Named:
    """The same as `looked_up`, which says how sure it is."""
    first = selection.views[0] if selection.views else 0
    found, known = _asked(photos, selection, first)
    weighed = {view: _weighed(photos, view, found) for view in found}
    best = max(weighed, key=lambda view: _confidence(weighed[view]), default=first)
    if _confidence(weighed.get(best, ())) <= SURER * _confidence(
        weighed.get(first, ())
    ):
        best = first
    if not weighed.get(best):
        return _standing_out(photos, selection, first, known)
    named = _taken(photos, selection, best, weighed[best])
    if selection.larger or selection.candidate > 1:
        return named
    if _on_every_photo(selection, weighed[best], named, best):
        return _on_others(photos, selection, named, best)
    own = {
        view: _own(photos, view, there, best, named)
        for view, there in weighed.items()
        if view != best and not selection.qualifiers and selection.words != BACKGROUND
    }
    return _kept(selection, named, {view: one for view, one in own.items() if one})


def _own(
    photos: Photos, view: int, there: Proposals, best: int, named: Named
) -> Proposal | None:
    """What a photo finds itself is never thrown away because another one is surer; None where
    geometry says that none of it is what that other one shows. What geometry confirms is as sure as
    there.
    """
    surface, mask = photos.shared(view, best), named.found[best].mask
    if not there or surface is None:
        return there[0] if there else None
    grid, same = surface
    moved = warp(mask[None], grid, padding="zeros")[0] * same
    if (moved > 0.5).sum() < SEES * (mask > 0.5).sum():
        return there[0]
    shares = [overlap(one.soft_mask * same, moved) for one in there]
    likeliest = max(range(len(there)), key=shares.__getitem__)
    if shares[likeliest] < SAME_THING:
        return None
    return replace(there[likeliest], confidence=named.confidence or 0.0)


def _kept(selection: Selection, named: Named, own: Mapping[int, Proposal]) -> Named:
    """What was named, with what other photos found themselves: it is as sure as the least of it."""
    if not own:
        return named
    view, least = min(own.items(), key=lambda pair: pair[1].confidence)
    confidence = min(named.confidence or 0.0, least.confidence)
    warnings = named.warnings
    if confidence < SURE <= (named.confidence or 0.0):
        what = f"{selection.words!r} was found on photo {view + 1}"
        warnings += (
            f"{what} with a confidence of only {confidence:.0%}: look at its outline there. To "
            f"correct it: {ASK}.",
        )
    kept = {view: OnPhoto(one.soft_mask, "words") for view, one in own.items()}
    return replace(
        named, found={**kept, **named.found}, confidence=confidence, warnings=warnings
    )


def named_again(
    photos: Photos, selection: Selection, named: Named, view: int, lost: OnPhoto
) -> OnPhoto:
    """What words find, as surely as elsewhere, on a photo where the thing was lost, or was carried
    to by depths that are mostly guessed; what is there already where they find the same or nothing.
    """
    again = lost.how == "not found" or (
        lost.how == "geometry" and _guessed(photos, named)
    )
    only = not selection.qualifiers and not selection.larger
    if named.confidence is None or not (again and only):
        return lost
    there = _text(photos, selection, view)[0]
    sure = [one.soft_mask for one in there if one.confidence >= named.least]
    if not sure:
        return lost
    likeliest = max(sure, key=lambda mask: overlap(mask, lost.mask))
    is_same = overlap(likeliest, lost.mask) >= SAME_THING
    return lost if is_same else OnPhoto(likeliest, "words")


def _guessed(photos: Photos, named: Named) -> bool:
    """Whether the depths of most of what words found were guessed, so that a place in another photo
    is a guess as well.
    """
    if photos.geometry is None:
        return False
    sure = photos.geometry.is_measured[0]
    shares = [
        float(sure[view][one.inside].double().mean())
        for view, one in named.found.items()
        if one.inside.any()
    ]
    return max(shares, default=0.0) < SEES


def _asked(
    photos: Photos, selection: Selection, first: int
) -> tuple[Mapping[int, Proposals], bool]:
    """What the words name on each photo that is looked at, and whether anybody knows them.

    Others than the first are asked where that is not sure; which is the left one is said of the
    first alone, and "the big one" may be one of anything.
    """
    if not selection.words:
        if not selection.qualifiers:
            return {}, False
        some = automatic_masks(photos.segmenter, photos.images[first])
        return {first: tuple(replace(one, confidence=SURE / 2) for one in some)}, True
    there, known = _text(photos, selection, first)
    if not known:
        return {}, False
    found = {first: there}
    if not selection.qualifiers and _confidence(there) < SURE:
        others = [view for view in range(photos.count) if view != first]
        for view in others[: ASKED - 1]:
            found[view] = _text(photos, selection, view)[0]
    return found, True


def _text(photos: Photos, selection: Selection, view: int) -> tuple[Proposals, bool]:
    """What the words name on a photo, and whether the segmenter knows them."""
    image = photos.images[view]
    if selection.words == BACKGROUND:
        told: Proposals | None = _background(photos.segmenter, image)
    else:
        told = asking.words(photos.segmenter, image, selection.words)
    likely = [one for one in told or () if one.confidence >= FOUND_AT_ALL]
    return tuple(likely), told is not None


def _background(segmenter: Segmenter, image: Image) -> Proposals:
    """All but what stands out most on the photo, as surely as that does."""
    warn("the background is taken to be all but what stands out most on the photo.")
    subject = subject_of(segmenter, image)
    return tuple(replace(one, soft_mask=1 - one.soft_mask) for one in subject[:1])


def _confidence(found: Sequence[Proposal]) -> float:
    return found[0].confidence if found else 0.0


def _weighed(photos: Photos, view: int, found: Mapping[int, Proposals]) -> Proposals:
    """What a photo shows, the likeliest first, with less confidence for what others see and do not
    confirm: a thing is a thing on all photos.
    """
    others = [other for other in found if other != view]
    weighed = []
    for one in found[view]:
        told = [_confirmed(photos, view, one, other, found[other]) for other in others]
        seen = [share for share in told if share is not None]
        share = sum(seen) / len(seen) if seen else 1.0
        left = UNCONFIRMED + (1 - UNCONFIRMED) * share
        weighed.append(replace(one, confidence=one.confidence * left))
    likely = [one for one in weighed if one.confidence >= FOUND_AT_ALL]
    return tuple(sorted(likely, key=lambda one: -one.confidence))


def _confirmed(
    photos: Photos, view: int, one: Proposal, other: int, there: Proposals
) -> float | None:
    """Overlap with what another photo means; None where that does not see the place."""
    surface = photos.shared(view, other)
    inside = one.soft_mask > 0.5
    if surface is None:
        return None
    grid, same = surface
    seen = inside & same
    if not inside.any() or seen.sum() < SEES * inside.sum():
        return None
    moved = [
        warp(its.soft_mask[None].to(grid), grid, padding="zeros")[0] for its in there
    ]
    return max((overlap(mask * same, seen.to(mask)) for mask in moved), default=0.0)


def _taken(photos: Photos, selection: Selection, view: int, found: Proposals) -> Named:
    """The mask of those of `found` that are meant, and what else may be."""
    words, which = selection.words, selection.qualifiers
    alike = () if which else _also(found)
    several = alike if selection.several else ()
    picked = several or pick(found, which, photos.images[view])
    sure = [one.confidence for one in picked if one.confidence >= SURE]
    confidence = min(sure if several else [one.confidence for one in picked])
    least = min(SURE, confidence)
    warnings: list[str] = []
    if not several and len(alike) > 1:
        confidence /= len(alike)  # nothing says which of them is meant
        warnings.append(
            f"{len(alike)} things on photo {view + 1} may be {words!r}, and the likeliest is "
            f"taken; say which is meant ('the left {words}')."
        )
    named = " ".join((*which, words)).strip()
    if len(picked) > 1:
        say("selection.several", f"{len(picked)} {words} on photo {view + 1}")
    masks = [_stepped(photos, view, one, selection.larger) for one in picked]
    mask = torch.stack(masks).amax(0)
    options: tuple[Candidate, ...] = ()
    if confidence < SURE and not selection.larger:
        options = numbered(view, _options(photos, view, picked, found))
        mask = taken_of(options, selection.candidate).mask
        others = [its.number for its in options if its.mask is not mask]
        warnings.append(
            f"{named!r} was found on photo {view + 1} with a confidence of only {confidence:.0%}: "
            f"look at its outline. To correct it{_taking(others)} {ASK}."
        )
    here = {view: OnPhoto(mask, "words")}
    return Named(here, confidence, least, options, tuple(warnings))


def _taking(numbers: Sequence[int]) -> str:
    return f", take {candidate_flags(numbers)}, or" if numbers else ":"


def numbered(view: int, options: Iterable[tuple[Mask, float]]) -> tuple[Candidate, ...]:
    """What differs among masks and their scores, the likeliest first; one that shows nothing only
    where there is no other.
    """
    kept: list[tuple[Mask, float]] = []
    options = list(options)
    shown = [one for one in options if bool((one[0] > 0.5).any())] or options[:1]
    for mask, score in shown:
        if all(overlap(mask, other) < SAME for other, _ in kept):
            kept.append((mask, score))
    return tuple(
        Candidate(view, mask, float(score), number)
        for number, (mask, score) in enumerate(kept[:MAX_CANDIDATES], 1)
    )


def taken_of(options: Sequence[Candidate], wanted: int) -> Candidate:
    """The candidate of that number; the last where there are fewer."""
    return options[min(wanted, len(options)) - 1]


def _options(
    photos: Photos, view: int, picked: Proposals, found: Proposals
) -> list[tuple[Mask, float]]:
    """What unsure words may mean: what was picked, others of that name, more or less of it."""
    confidence = min(one.confidence for one in picked)
    options = [(torch.stack([one.soft_mask for one in picked]).amax(0), confidence)]
    options += [(one.soft_mask, one.confidence) for one in found]
    if any(picked[0].box[2:]):
        box = Marks(box=_share_of(photos, picked[0]))
        boxed = answered(photos.segmenter, photos.images[view], box).candidates
        options += [(one.soft_mask, one.confidence * confidence) for one in boxed]
    return options


def _share_of(photos: Photos, one: Proposal) -> Box:
    """The box of a proposal."""
    height, width = photos.images.shape[-2:]
    x, y, across, down = one.box
    return x / width, y / height, across / width, down / height


def _stepped(photos: Photos, view: int, one: Proposal, larger: int) -> Mask:
    """The mask of a named thing; a larger or smaller candidate of its box where that is asked."""
    if not larger:
        return one.soft_mask
    marks = Marks(box=_share_of(photos, one), larger=larger)
    return answered(photos.segmenter, photos.images[view], marks).mask


def _also(found: Proposals) -> Proposals:
    """Those that are sure, and others that are likely beside them; none where none is sure."""
    if all(one.confidence < SURE for one in found):
        return ()
    return tuple(one for one in found if one.confidence >= ALSO)


def _on_every_photo(
    selection: Selection, found: Proposals, named: Named, best: int
) -> bool:
    """Whether words are looked for on each photo: several walk, and beyond the border a thing has
    parts that another photo shows.
    """
    if selection.qualifiers:
        return bool(set(selection.qualifiers) & EVERY)
    if selection.several and _also(found):
        return True
    inside, is_sure = named.found[best].inside, (named.confidence or 0) >= SURE
    sides = (inside[0], inside[-1], inside[:, 0], inside[:, -1])
    spans = max(float(side.double().mean()) for side in sides) > SPANS
    return is_sure and spans and selection.words != BACKGROUND


def _on_others(photos: Photos, selection: Selection, named: Named, best: int) -> Named:
    """All of that name on the other photos too, as surely as on the best."""
    found = dict(named.found)
    for view in set(range(photos.count)) - {best}:
        there = _text(photos, selection, view)[0]
        likely = [one for one in there if one.confidence >= named.least]
        masks = [one.soft_mask for one in _also(there) or likely]
        if masks:
            found[view] = OnPhoto(torch.stack(masks).amax(0), "words")
    return replace(named, found=found, each=len(found) > 1)


def _standing_out(
    photos: Photos, selection: Selection, view: int, known: bool
) -> Named:
    """What stands out on a photo, with other candidates: nothing is refused that can be shown."""
    why = _why_not(photos, selection, view, known)
    some = standing_out(photos.segmenter, photos.images[view])
    if not some:
        raise InputError(f"{why}, and nothing stands out on photo {view + 1}; {ASK}.")
    first = pick(some, selection.qualifiers, photos.images[view])[0]
    sure = min(GUESSED, first.confidence)
    rest = [one for one in some if one is not first]
    # what no network weighed says nothing of how likely it is
    others = [
        (one.soft_mask, min(one.confidence, sure / 2**number))
        for number, one in enumerate(rest, 1)
    ]
    options = numbered(view, [(first.soft_mask, sure), *others])
    numbers = [one.number for one in options[1:]]
    warning = (
        f"{why}; what stands out is taken, with a confidence of {sure:.0%} only: look at its "
        f"outline. To correct it{_taking(numbers)} {ASK}"
    )
    more = _more_words() if selection.words and not known else ""
    warning += f", or {more}." if more else "."
    taken = taken_of(options, selection.candidate)
    found = {view: OnPhoto(taken.mask, "guess")}
    knows_words = known or not selection.words
    return Named(found, sure, SURE, options, (warning,), knows_words=knows_words)


def _why_not(photos: Photos, selection: Selection, view: int, known: bool) -> str:
    """Why the words found nothing."""
    words = selection.words
    if not words:
        return "nothing says which object is meant"
    if known:
        return f"{words!r} was not found on photo {view + 1}"
    name = component_name(photos.segmenter)
    return f"{words!r} is not a word that segmenter {name!r} knows"


def _more_words() -> str:
    """What to fetch, so that more words are known; "" where nothing more is offered."""
    for offer in default_registry().offers("detector"):
        one = offer.component
        bundles = [its.bundle for its in one.weights if its.bundle]
        if bundles and not any(map(at_hand, one.weights)):
            install = f"pip install 'edit3r[{one.extra}]' and " if one.extra else ""
            return (
                f"fetch what knows more words: {install}edit3r weights get {bundles[0]}"
            )
    return ""
