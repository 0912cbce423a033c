"""Words that nobody knows, so that none of them disappears into the name of a thing."""

from collections.abc import Sequence
from functools import cache

from edit3r.contract.instructions import EVERY, FLOOD
from edit3r.kit.compute.colour_names import NEON, TONES, read_colour
from edit3r_language.nouns import is_noun
from edit3r_language.paints import LIGHT_WORDS, MATERIALS
from edit3r_language.vocabulary import (
    ADJUSTMENTS,
    PROPERTIES,
    TINTS,
    WORDS,
    words_of,
)

_WITHIN_A_COLOUR = words_of("a an of some sort kind shade tone hue full")


def is_known(word: str) -> bool:
    """Whether a word has a place in sentences: it is a word of the grammar, a colour or a thing."""
    plain = word.removesuffix("'s")
    if word in _grammar() or word != plain or is_noun(plain):
        return True
    return read_colour([word]) is not None or word.endswith("ing") or word.isdigit()


def unknown_words(named: Sequence[str], before_change: bool) -> tuple[str, ...]:
    """The words around a thing's name that nobody knows.

    After "the" any word may be a thing's, but not one between a thing and its colour: "the wall
    zorbic green" (`before_change`). Before "the" no unknown word is: "pant the wall".
    """
    content = [place for place, word in enumerate(named) if _is_content(word)]
    articles = [i for i, word in enumerate(named) if word in WORDS.determiners]
    determined = min(articles, default=len(named))
    last = _last(named, content) if before_change else -1
    found = []
    for place in content:
        others = len(content) > 1 or last == place
        early = place < determined and others and not is_known(named[place])
        late = place == last and content[0] != place and not _ends_name(named[place])
        if early or late:
            found.append(named[place])
    return tuple(found)


def _last(named: Sequence[str], content: Sequence[int]) -> int:
    """The place of the word before the change: "lick" in "the van a lick of"; -1 after "in"."""
    if not content:
        return -1
    between = set(named[content[-1] + 1 :])
    return content[-1] if between <= _WITHIN_A_COLOUR | WORDS.paint else -1


def _ends_name(word: str) -> bool:
    """Whether a thing's name may end with a word, right before its new colour."""
    return is_noun(word) or (is_known(word) and not _is_shade(word))


def _is_shade(word: str) -> bool:
    return read_colour([word]) is not None or word in WORDS.looks or word in TONES


def unread_of(content: Sequence[str]) -> tuple[str, ...]:
    """Of the words of a clause that asks for nothing known, those that are to blame."""
    blamed = tuple(word for word in content if not is_noun(word) or word in TONES)
    strange = tuple(word for word in blamed if word not in WORDS.more | WORDS.less)
    return strange or blamed or tuple(content)


def _is_content(word: str) -> bool:
    ignored = WORDS.fillers | WORDS.weak | WORDS.strong | WORDS.paint
    ignored |= WORDS.determiners - WORDS.pronouns
    return word not in ignored or word in WORDS.pronouns - {"that", "this"}


@cache
def _grammar() -> frozenset[str]:
    """Every word that the grammar gives a meaning."""
    changes = (ADJUSTMENTS, PROPERTIES, TINTS, LIGHT_WORDS, MATERIALS)
    return WORDS.known.union(EVERY, FLOOD, *changes, TONES, NEON)
