"""Words that are known: everyday things, to tell a noun from a misspelt colour, and the grammar's.

A word that nobody knows must not disappear into the name of a thing.
"""

import difflib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files

from edit3r.contract.instructions import EVERY, FLOOD, Colour
from edit3r.kit.compute.colour_names import BASIC_COLOURS, NEON, TONES, read_colour
from edit3r_language.paints import LIGHT_WORDS, MATERIALS
from edit3r_language.vocabulary import (
    ADJUSTMENTS,
    PROPERTIES,
    TINTS,
    WORDS,
    words_of,
)

_PLURALS = frozenset(("people", "children", "men", "women", "feet", "teeth", "mice"))
"""Of words whose plural has no rule, or that stand for several."""

_WITHIN_A_COLOUR = words_of("a an of some sort kind shade tone hue full")


def is_noun(word: str) -> bool:
    """Whether a word, singular, plural or with 's, is on the list of everyday things."""
    word = word.removesuffix("'s")
    return any(form in _nouns() for form in _singulars(word))


def is_plural(word: str) -> bool:
    """Whether a word is the plural of an everyday thing: "cups", but not "glasses"."""
    return word in _PLURALS or (word not in _nouns() and is_noun(word))


def near_nouns(word: str) -> list[str]:
    """Everyday things that a slip makes an unknown word: "fxo" is "fox" with two letters swapped.

    In words of more than three letters one may also be left out, added or wrong, but for the first.
    """
    if is_noun(word):
        return []
    pairs = range(len(word) - 1)
    swapped = [word[:i] + word[i + 1] + word[i] + word[i + 2 :] for i in pairs]
    meant = [other for other in swapped if is_noun(other)]
    if meant or len(word) <= 3:
        return meant
    near = difflib.get_close_matches(word, sorted(_nouns()), n=2, cutoff=0.85)
    return [noun for noun in near if noun[0] == word[0]]


def is_thing_too(colour: Colour) -> bool:
    """Whether a colour's name is a thing as well: "rose", "sand", "wine"."""
    return colour.name not in BASIC_COLOURS and is_noun(colour.name)


def _singulars(word: str) -> tuple[str, ...]:
    """The word, and what it may be the plural of."""
    forms = [word]
    if word.endswith("s"):
        forms.append(word[:-1])
    if word.endswith("es"):
        forms.append(word[:-2])
    if word.endswith("ies"):
        forms.append(word[:-3] + "y")
    if word.endswith("ves"):
        forms += [word[:-3] + "f", word[:-3] + "fe"]
    return tuple(forms)


@cache
def _nouns() -> frozenset[str]:
    text = files("edit3r_language").joinpath("nouns.txt").read_text("utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return frozenset(" ".join(lines).split())


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
