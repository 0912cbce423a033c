"""A colour that is taken from another thing: "the colour of the stone", "as white as the door"."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from edit3r.contract.instructions import BENEATH, Change, Colour
from edit3r.kit.compute.colour_names import read_colour, read_colour_of
from edit3r_language.targets import read_target
from edit3r_language.vocabulary import WORDS, words_of

_STANDS = words_of(
    "stands stand standing sits sit sitting lies lie lying rests rest resting is are"
)


@dataclass(frozen=True)
class Taken:
    """A colour of another thing, said from word `start` to the end of the clause."""

    start: int
    change: Change


def read_taken(tokens: list[str]) -> Taken | None:
    """The colour that a clause takes from another thing, where a thing to paint stands before."""
    for start in range(1, len(tokens)):
        found = _source_at(tokens, start)
        if found is None or not _names_something(tokens[:start]):
            continue
        hue, source = found
        change = _of_thing(hue, source)
        if change is not None:
            return Taken(_with_article(tokens, start), change)
    return None


def _source_at(tokens: list[str], start: int) -> tuple[Colour | None, list[str]] | None:
    """The hue that is named, if any, and the words for the thing that has it."""
    first, rest = tokens[start], tokens[start + 1 :]
    if first in ("match", "matching"):
        return None, rest
    if first == "colour" and rest[:1] and rest[0] in ("of", "as", "from"):
        return None, rest[1:]
    before = tokens[start - 1]
    found = read_colour(tokens[start:])
    if found is None or before not in ("the", "same", "as"):
        return None
    hue, length = found
    after = tokens[start + length :]
    joins = ("as",) if before in ("same", "as") else ("of", "from")
    return (hue, after[1:]) if after[:1] and after[0] in joins else None


def _of_thing(hue: Colour | None, source: Sequence[str]) -> Change | None:
    """Paint in the colour of a thing; "the colour of chocolate" is a colour by its name."""
    beneath = _is_beneath(source)
    source = _without_tail(source)
    found = read_colour_of(list(source))
    if hue is None and found is not None and found[1] == len(source):
        return Change("paint", found[0])
    if not _names_something(source):
        return None
    target = replace(read_target(list(source)), part=hue)
    if beneath and not target.of:
        target = replace(target, of=BENEATH)
    if target.scope == "marked":  # "the colour of what I clicked on"
        target = replace(target, name="")
    return Change("paint", like=target)


def _without_tail(source: Sequence[str]) -> Sequence[str]:
    """The thing without "it stands on", which says no more about its colour."""
    for place, word in enumerate(source):
        if place and word in WORDS.pronouns:
            return source[:place]
    return source


def _is_beneath(source: Sequence[str]) -> bool:
    """Whether "it stands on" follows a thing, which says where it is."""
    pronoun = bool(set(source[1:]) & WORDS.pronouns)
    return pronoun and source[-1] == "on" and bool(set(source[1:]) & _STANDS)


def _names_something(tokens: Sequence[str]) -> bool:
    ignored = WORDS.fillers | WORDS.paint | WORDS.imperatives | {"same"}
    ignored |= WORDS.determiners - WORDS.pronouns
    return bool(set(tokens) - ignored)


def _with_article(tokens: list[str], start: int) -> int:
    """Where "in exactly the same colour of ..." begins."""
    while start and tokens[start - 1] in {*WORDS.articles, "same", "as", "in", "to"}:
        start -= 1
    return start
