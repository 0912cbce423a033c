"""The first of the three answers: what was selected, and how likely it is what was meant."""

from collections.abc import Sequence

from edit3r.contract.interfaces import ASK, Selected
from edit3r.contract.verdicts import SelectionVerdict

MARKED = "what is marked"
GUESS = "guess"  # of `Selected.how`: nobody said what is meant


def verdict_on_selection(
    things: Sequence[Selected], confined: bool = False
) -> SelectionVerdict | None:
    """What is said of all things that were looked for; None where none was.

    `confined`: some pixels must stay as they are, as where masks were handed over.

    The least confident one decides. A thing that was marked exactly, or taken as another candidate
    (`--reading`), is what was asked for: it has no confidence.
    """
    if not things:
        return SelectionVerdict("given", MARKED, None) if confined else None
    listed = "; ".join(dict.fromkeys(_said(one) for one in things))
    open_ones = [one for one in things if _confidence(one) is not None]
    if not open_ones:
        return SelectionVerdict("given", listed, None)
    least = min(open_ones, key=lambda one: _confidence(one) or 0.0)
    confidence = _confidence(least)
    if least.is_sure:
        return SelectionVerdict("found", listed, confidence)
    others = tuple(one.number for one in least.readings if one.number != least.taken)
    way = f"if it is another thing, {ASK}"
    if others:
        numbers = " or ".join(map(str, others))
        way = f"look at its outline on the sheet; --reading {numbers} takes another candidate"
    return SelectionVerdict("question", f"{listed}; {way}", confidence, others)


def _confidence(one: Selected) -> float | None:
    """None for what somebody took after a look at the candidates, too."""
    return None if one.taken > 1 else one.confidence


def _said(one: Selected) -> str:
    """A thing as people say it, how confidently it was found, and the photos that lack it."""
    name = one.called or MARKED
    confidence = _confidence(one)
    if one.called and "marked" in one.how and not one.fits:
        why = "was not checked" if one.fits is None else "was found elsewhere"
        name = f"{MARKED} ({one.called!r} {why})"
    if GUESS in one.how:
        name = ": ".join(filter(None, (one.called, "what stands out most")))
    if confidence is not None:
        name = f"{name}, confidence {confidence:.0%}"
    lost = [str(view + 1) for view, how in enumerate(one.how) if how == "not found"]
    return f"{name}, not found on photo {' and '.join(lost)}" if lost else name
