"""Read the words that name a thing: "the left cup", "the red parts of the bike", "the rest"."""

from dataclasses import replace

from edit3r.contract.instructions import EVERY, Colour, Target
from edit3r.kit.compute.colour_names import read_colour
from edit3r_language.known_words import is_known, is_noun, is_plural, is_thing_too
from edit3r_language.paints import LIGHT_WORDS
from edit3r_language.places import read_region
from edit3r_language.vocabulary import WORDS

_JOINING = WORDS.joining - {"at", "to", "next", "above", "below"}


def read_target(tokens: list[str]) -> Target:
    """The thing that the words name; without any, what the user marked.

    A pronoun stands for what was named last and is returned under the name "it".
    """
    tokens = [token for token in tokens if token not in WORDS.politeness]
    return read_region(tokens) or _read_named(tokens)


def _read_named(tokens: list[str]) -> Target:
    """The thing by its noun, with what picks it among several and the whole it is a part of."""
    possessive = bool(set(tokens) & WORDS.possessives)
    tokens, of = _whole_of(tokens)
    part, named = _colour_of_part(_naming(tokens), tokens)
    nouns = [t for t in named if t not in WORDS.whole | EVERY]
    if set(nouns) & WORDS.rest or (set(nouns) and set(nouns) <= WORDS.background):
        return Target("background", of=_foreground(of), part=part)
    which = [t for t in nouns if t in WORDS.places | WORDS.sizes | WORDS.background]
    nouns = [t for t in nouns if t not in which]
    one = bool(set(tokens) & {"one", "ones"})
    colours, nouns = _leading_colours(nouns, one)
    if of and which and not nouns and part is None:  # "the top of the tower"
        return Target("named", " ".join(which), of=_named_whole(of))
    if of and (part is not None or not nouns):
        return _part_of(of, part)
    if not (nouns or which or (colours and one)):
        return _unnamed(tokens, part)
    every = [token for token in tokens if token in EVERY]
    picks = tuple(dict.fromkeys((*every, *which, *colours)))
    name = " ".join(nouns).removesuffix("'s")
    whole = _named_whole(of)
    if nouns and possessive:
        whole = whole or "it"
    several = not picks and bool(nouns) and is_plural(nouns[-1])
    unknown = () if not nouns or not is_noun(nouns[-1]) else _unknown(nouns[:-1])
    return Target("named", name, picks, whole, part, several=several, unknown=unknown)


def _foreground(of: list[str]) -> str:
    """What stands before "the background of the fox"; the room itself in "that of the room"."""
    content = [t for t in of if t not in WORDS.fillers | WORDS.determiners]
    return "" if not content or set(content) <= WORDS.scenes else _named_whole(of)


def _unknown(adjectives: list[str]) -> tuple[str, ...]:
    """Words before a noun that may be its, and that nobody knows: "zorbic wall"."""
    return tuple(word for word in adjectives if not is_known(word))


def _naming(tokens: list[str]) -> list[str]:
    """The words that say which thing, without those that only join them."""
    ignored = WORDS.fillers | WORDS.paint | WORDS.determiners | WORDS.pronouns
    ignored |= WORDS.object | WORDS.weak | WORDS.strong | WORDS.random | WORDS.nice
    return [t for t in tokens if t not in ignored or t == "everything"]


def _part_of(whole: list[str], part: Colour | None) -> Target:
    """The whole that "the red parts of" says, where it is red."""
    inner = read_target(whole)
    return replace(inner, part=part or inner.part)


def _unnamed(tokens: list[str], part: Colour | None) -> Target:
    """What "it", "all of it", "everything" or no word stands for."""
    pronoun = set(tokens) & (WORDS.pronouns | WORDS.object)
    subject = "".join(t for t in tokens if t in WORDS.object - {"main"})
    if pronoun and set(tokens) & {"whole", "all"}:  # "all of it"
        return Target("marked", "it", qualifiers=("whole",), part=part)
    if set(tokens) & WORDS.whole or part is not None:
        return Target("whole", part=part)
    return Target("marked", subject or ("it" if pronoun else ""), part=part)


def _named_whole(tokens: list[str]) -> str:
    """The words for what a thing is a part of, or is known by: "red jacket"."""
    whole = read_target(tokens)
    return " ".join((*whole.qualifiers, *whole.name.split()))


def _whole_of(tokens: list[str]) -> tuple[list[str], list[str]]:
    """Split "the tank of the motorcycle" and "the motorcycle's tank" into tank and motorcycle."""
    for start, token in enumerate(tokens):
        rest = tokens[start + 1 :]
        content = [t for t in rest if t not in WORDS.fillers | WORDS.determiners]
        inner = [t for t in tokens[:start] if t not in WORDS.fillers | WORDS.paint]
        if token in _JOINING and content and inner:
            places = WORDS.places | WORDS.background | {"foreground"}
            around = (
                token == "of" and set(inner) <= WORDS.background | WORDS.determiners
            )
            if set(content) & places and not around:  # "the cup on the left"
                picked = [
                    t.replace("foreground", "front") for t in content if t in places
                ]
                return tokens[:start] + picked, _wearer([token, *rest], content, places)
            return tokens[:start], rest
        if token in ("at", "to") and set(content) & WORDS.places and inner:
            return tokens[:start] + [t for t in content if t in WORDS.places], []
        if token.endswith("'s") and content:
            return rest, [*tokens[:start], token.removesuffix("'s")]
    return tokens, []


def _wearer(words: list[str], content: list[str], places: frozenset[str]) -> list[str]:
    """The whole in "the jacket of the man on the left"; in "of the left" there is none."""
    ignored = places | _JOINING | WORDS.parts | WORDS.picture | WORDS.determiners
    others = [t for t in content if t not in ignored | WORDS.shares]
    return others if "of" in words else []


def _colour_of_part(
    named: list[str], tokens: list[str]
) -> tuple[Colour | None, list[str]]:
    """Take "red parts" out of the words: only pixels near red are meant."""
    for start in range(len(named)):
        found = read_colour(named[start:])
        if found is None:
            continue
        colour, length = found
        after = named[start + length : start + length + 1]
        one = set(tokens) & {"one", "ones"}
        if (after and after[0] in WORDS.parts) or (len(named) == length and not one):
            if not after and is_noun(colour.name.split()[-1]):  # "the rose"
                return None, named
            return colour, named[:start] + named[start + length + 1 :]
        whole = set(named[:start]) & WORDS.whole
        if whole and not after:  # "everything red"
            return colour, named[:start]
    return None, named


def _leading_colours(nouns: list[str], alone: bool) -> tuple[list[str], list[str]]:
    """Split "red cup" into the colour that picks it and its name; in "the red one" it is alone."""
    light = [noun for noun in nouns[:1] if noun in LIGHT_WORDS]
    found = read_colour(nouns[len(light) :])
    left = len(nouns) - len(light)
    if found is None or (found[1] >= left and not alone) or is_thing_too(found[0]):
        return [], nouns
    colour, length = found
    return [*light, colour.name], nouns[len(light) + length :]
