"""The first of the three answers at the end of a run: what was selected, and how surely."""

from collections.abc import Sequence
from dataclasses import replace

from edit3r.contract.interfaces import ASK, Selected, candidate_flags
from edit3r.contract.verdicts import SelectionVerdict

MARKED = "what is marked"
GUESS = "guess"  # of `Selected.how`: nobody said what is meant


def verdict_on_selection(
    things: Sequence[Selected], exactly: str = "", chosen: bool = False
) -> SelectionVerdict | None:
    """What is said of all things that were looked for; None where none was.

    `exactly`: what else keeps some pixels as they are, such as masks that were handed over.

    The least confident one decides. A thing that was marked exactly, or taken as a numbered
    candidate (`chosen`, `--candidate`), is what was asked for: it has no confidence.
    """
    if chosen:
        things = [replace(one, confidence=None) for one in things]
    if not things:
        return SelectionVerdict("given", exactly, None) if exactly else None
    listed = "; ".join(dict.fromkeys(_in_words(one) for one in things))
    open_ones = [one for one in things if _confidence(one) is not None]
    if not open_ones:
        return SelectionVerdict("given", listed, None)
    least = min(open_ones, key=lambda one: _confidence(one) or 0.0)
    confidence = _confidence(least)
    if least.is_sure:
        return SelectionVerdict("found", listed, confidence)
    others = tuple(one.number for one in least.candidates if one.number != least.taken)
    way = f"if it is another thing, {ASK}"
    if others:
        flags = candidate_flags(others)
        way = f"look at its outline on the sheet; {flags} takes another candidate"
    return SelectionVerdict("question", f"{listed}; {way}", confidence, others)


def _confidence(one: Selected) -> float | None:
    """None for what somebody took after a look at the candidates, too."""
    return None if one.taken > 1 else one.confidence


def _in_words(one: Selected) -> str:
    """A thing as people say it, how confidently it was found, and the photos that lack it."""
    name = one.called or MARKED
    confidence = _confidence(one)
    # words find where nothing else says where; clicks beside the thing then say what it is not
    is_marked = "marked" in one.how and "words" not in one.how
    if one.called and is_marked and not one.fits:
        why = "was not checked" if one.fits is None else "was found elsewhere"
        name = f"{MARKED} ({one.called!r} {why})"
    if GUESS in one.how:
        name = ": ".join(filter(None, (one.called, "what stands out most")))
    if confidence is not None:
        name = f"{name}, confidence {confidence:.0%}"
    lost = [str(view + 1) for view, how in enumerate(one.how) if how == "not found"]
    return f"{name}, not found on photo {' and '.join(lost)}" if lost else name
