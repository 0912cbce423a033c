"""Everyday words for things, to tell a noun from a misspelt colour; others are things too."""

import difflib
from functools import cache
from importlib.resources import files

from edit3r.contract.instructions import Colour
from edit3r.kit.compute.colour_names import BASIC_COLOURS

_PLURALS = frozenset(("people", "children", "men", "women", "feet", "teeth", "mice"))
"""Of words whose plural has no rule, or that stand for several."""


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
