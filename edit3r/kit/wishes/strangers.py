"""Words that nobody knows, so that none of them disappears into the name of a thing."""

from collections.abc import Sequence
from functools import cache

from edit3r.kit.wishes import vocabulary as words
from edit3r.kit.wishes.colours import NEON, TONES, read_colour
from edit3r.kit.wishes.nouns import is_noun
from edit3r.kit.wishes.paints import LIGHT_WORDS, MATERIALS


def is_known(word: str) -> bool:
    """Whether a word has a place in sentences: it is a word of the grammar, a colour or a thing."""
    plain = word.removesuffix("'s")
    if word in _grammar() or word != plain or is_noun(plain):
        return True
    return read_colour([word]) is not None or word.endswith("ing") or word.isdigit()


def strangers(named: Sequence[str], before_change: bool) -> tuple[str, ...]:
    """The words around a thing's name that nobody knows.

    After "the" any word may be a thing's, but not one between a thing and its colour: "the wall
    zorbic green" (`before_change`). Before "the" no unknown word is: "pant the wall".
    """
    content = [place for place, word in enumerate(named) if _is_content(word)]
    determined = next(
        (i for i, word in enumerate(named) if word in words.DETERMINERS), len(named)
    )
    last = len(named) - 1 if before_change else -1
    found = []
    for place in content:
        others = len(content) > 1 or last == place
        early = place < determined and others
        late = place == last and content[0] != place
        if (early or late) and not is_known(named[place]):
            found.append(named[place])
    return tuple(found)


def unread_of(content: Sequence[str]) -> tuple[str, ...]:
    """Of the words of a clause that asks for nothing known, those that are to blame."""
    blamed = tuple(word for word in content if not is_noun(word) or word in TONES)
    return blamed or tuple(content)


def _is_content(word: str) -> bool:
    ignored = words.FILLERS | words.WEAK | words.STRONG | words.PAINT
    ignored |= words.DETERMINERS - words.PRONOUNS
    return word not in ignored or word in words.PRONOUNS - {"that", "this"}


@cache
def _grammar() -> frozenset[str]:
    """Every word that the grammar gives a meaning."""
    sets = (
        words.FILLERS,
        words.WEAK,
        words.STRONG,
        words.RANDOM,
        words.PAINT,
        words.NICE,
        words.DETERMINERS,
        words.PLACES,
        words.SIZES,
        words.EVERY,
        words.PARTS,
        words.SHARES,
        words.WHOLE,
        words.BACKGROUND,
        words.REST,
        words.OBJECT,
        words.FLOOD,
        words.MORE,
        words.LESS,
        words.LOOKS,
        words.IMPERATIVES,
        words.DESCRIBING,
        words.JOINING,
        words.ADJUSTMENTS,
        words.PROPERTIES,
        words.TINTS,
        LIGHT_WORDS,
        MATERIALS,
        TONES,
        NEON,
    )
    return frozenset().union(*sets)
