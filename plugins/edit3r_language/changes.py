"""The changes of colour that a clause asks for, and where they stand in it."""

from dataclasses import dataclass, replace

from edit3r.contract.instructions import Change
from edit3r.kit.compute.colour_names import BASIC_COLOURS, TONES, read_colour
from edit3r_language.known_words import is_noun, is_thing_too
from edit3r_language.paints import read_paint
from edit3r_language.shades import read_taken
from edit3r_language.vocabulary import ADJUSTMENTS, PROPERTIES, TINTS, WORDS, words_of

_BOTTLES_AND_TREES = words_of("bottle tree leaf")
_OF_BOTTLES_AND_TREES = words_of(
    "wine beer water milk juice glass plastic apple pear orange lemon lime cherry fig olive "
    "banana palm pine oak birch maple christmas"
)
_BASIC = frozenset(BASIC_COLOURS)
_BEFORE_SNOW = words_of("of into to like in with")
TINT_SHARE = 0.35  # how far a tint goes towards its colour, in [0, 1]; no figure kept
PERCENT_AS_NAMED = {"saturation": (80, 60), "contrast": (45, 31)}
"""What "more saturated" alone adds and "less saturated" takes away [%]."""

PERCENT_OF_LIGHT = (30, 30)
"""The same for brightness, of a medium grey, and for warmth."""


@dataclass(frozen=True)
class ChangeSpan:
    """A change found at tokens[start:end]."""

    start: int
    end: int
    change: Change
    left_out: tuple[str, ...] = ()  # words in it that nobody can carry out


def find_changes(tokens: list[str]) -> list[ChangeSpan]:
    """All changes of a clause, in their order.

    "Wine" and "rose" are colours only where the clause wants one: not before another change.
    """
    taken = read_taken(tokens)
    if taken is not None:
        last = ChangeSpan(taken.start, len(tokens), taken.change)
        return [*_scan(tokens[: taken.start]), last]
    found = _scan(tokens)
    sure = [one.end for one in found if not _is_thing_too(one)]
    return [
        one
        for one in found
        if not _is_thing_too(one)
        or not any(end > one.end or _before_its_thing(tokens, end) for end in sure)
    ]


def last_group(changes: list[ChangeSpan], tokens: list[str]) -> list[ChangeSpan]:
    """The last changes with nothing but degree words between them.

    Earlier ones describe the thing: "make the red bike blue".
    """
    if not changes:
        return []
    group = [changes[-1]]
    for change in reversed(changes[:-1]):
        between = tokens[change.end : group[0].start]
        kinds = [found.change.kind for found in group]
        two_paints = change.change.kind == "paint" and "paint" in kinds
        if _only_praises(change, tokens):
            continue
        if two_paints or not set(between) <= WORDS.weak | WORDS.strong | {"a"}:
            break
        group.insert(0, change)
    return group


def scaled(change: Change, amount: float) -> Change:
    """The change at another strength; paint has none."""
    if change.kind == "paint":
        return change
    amount = change.amount * amount
    return replace(change, amount=min(1.0, amount) if change.kind == "tint" else amount)


def is_percentage(token: str) -> bool:
    """Whether a word says a share of what is, such as "30%"."""
    return token.endswith("%")


def amount_of(change: Change, tokens: list[str]) -> float:
    """How strong the words want the change, 1 as named."""
    more, less = PERCENT_AS_NAMED.get(change.kind, PERCENT_OF_LIGHT)
    for token in tokens:
        if is_percentage(token):
            return min(3.0, int(token[:-1]) / (less if change.amount < 0 else more))
    if set(tokens) & WORDS.weak:
        return 0.5
    return 1.7 if set(tokens) & WORDS.strong else 1.0


def _only_praises(change: ChangeSpan, tokens: list[str]) -> bool:
    """Whether a word such as "warm" changes nothing: "a nice warm yellow"."""
    before = tokens[: change.start][-1:]
    return tokens[change.start] in WORDS.nice and before in (["a"], ["nice"])


def _scan(tokens: list[str]) -> list[ChangeSpan]:
    found: list[ChangeSpan] = []
    index = 0
    while index < len(tokens):
        change = _change_at(tokens, index)
        if change is not None:
            found.append(change)
            index = change.end
        else:
            index += 1
    return found


def _is_thing_too(found: ChangeSpan) -> bool:
    colour = found.change.colour
    plain = found.change.kind == "paint" and not found.change.material
    return plain and colour is not None and is_thing_too(colour)


def _before_its_thing(tokens: list[str], end: int) -> bool:
    return tokens[end - 1] in WORDS.imperatives


def _change_at(tokens: list[str], start: int) -> ChangeSpan | None:
    rest = tokens[start:]
    first = rest[0]
    if first in WORDS.more | WORDS.less:
        return _more_or_less(rest, start)
    paint = _paint_at(tokens, start)
    if paint is not None:
        return paint
    if first in TINTS:
        return ChangeSpan(start, start + 1, _tint(TINTS[first]))
    if first in ADJUSTMENTS:
        return ChangeSpan(start, start + 1, ADJUSTMENTS[first])
    if first in WORDS.random:
        return ChangeSpan(start, start + 1, Change("random"))
    return None


def _paint_at(tokens: list[str], start: int) -> ChangeSpan | None:
    before, rest = tokens[:start], tokens[start:]
    if rest[0] == "snow" and not set(before[-1:]) & _BEFORE_SNOW:
        return None  # "make it snow"
    found = read_paint(rest)
    if found is None:
        return None
    after = rest[found.length : found.length + 1]
    shorter = read_paint(rest[1:]) if found.length > 1 else None
    if shorter is not None and _names_thing_and_colour(before, rest, found.length):
        return None
    if rest[0] in _BOTTLES_AND_TREES and set(before[-1:]) & _OF_BOTTLES_AND_TREES:
        return None  # "the wine bottle green", though "bottle green" is a colour
    if set(after) & WORDS.parts:
        return None  # "the red parts" are a thing
    adjusted = before[-1:] == ["the"] and bool(set(after) & set(ADJUSTMENTS))
    if adjusted and not set(before) - WORDS.fillers:
        return None  # "make the blue darker"
    change = found.change
    if "tint" in before and change.colour is not None and not change.material:
        change = Change("tint", change.colour, amount=TINT_SHARE)
    paint = ChangeSpan(start, start + found.length, change, found.left_out)
    if change.material and before[-1:] == ["the"] and not after:
        return None  # "lighten the wood"
    return None if _is_thing_too(paint) and _stands_as_thing(before, after) else paint


def _names_thing_and_colour(before: list[str], rest: list[str], length: int) -> bool:
    """Whether "the sea green" is a green sea, and "turn red blue" a change of red."""
    if before[-1:] == ["the"]:
        return rest[0] not in TONES
    two_basics = length == 2 and {rest[0], rest[1]} <= _BASIC
    return two_basics and not set(before) - WORDS.fillers - WORDS.paint


def _stands_as_thing(before: list[str], after: list[str]) -> bool:
    """Whether a word such as "rose" stands where a thing does: "the rose", "rose garden"."""
    follows = WORDS.determiners - {"a", "an"} | {"of", "on", "with", "near", "behind"}
    noun_next = bool(after) and is_noun(after[0]) and read_colour(after) is None
    return bool(set(before[-1:]) & follows) or noun_next


def _tint(name: str) -> Change:
    found = read_colour([name])
    assert found is not None  # every word of TINTS is a colour
    return Change("tint", found[0], amount=TINT_SHARE)


def _more_or_less(rest: list[str], start: int) -> ChangeSpan | None:
    """Read "more saturated", "increase the brightness", "less contrast", "more blue"."""
    sign = 1.0 if rest[0] in WORDS.more else -1.0
    skipped = 2 if rest[1:2] == ["the"] else 1
    word = rest[skipped] if len(rest) > skipped else ""
    end = start + skipped + 1
    if word in PROPERTIES:
        return ChangeSpan(start, end, Change(PROPERTIES[word], amount=sign))
    if word in ADJUSTMENTS:
        known = ADJUSTMENTS[word]
        return ChangeSpan(start, end, replace(known, amount=sign * known.amount))
    if rest[0] == "more" and word in _BASIC:  # "more snow" is no colour
        return ChangeSpan(start, end, _tint(word))
    return None
