"""Prompts that ask for the same thing twice in other words' order or number are one prompt."""

import re
from collections.abc import Callable, Iterable
from difflib import SequenceMatcher
from typing import TypeVar

__all__ = ["ALIKE", "likeness", "without_near_duplicates"]

Thing = TypeVar("Thing")

ALIKE = 0.82
"""Likeness from which two prompts count as one."""

_FILLERS = frozenset(re.findall(r"\w+", "a an the of to into in on with and please make turn change it its some"))


def likeness(first: str, second: str) -> float:
    """In [0, 1], 1 for equal prompts: the larger of the share of common words and of common letters in order.

    Case, punctuation, plural s and words that carry nothing are ignored. It knows no meaning: "red" and "crimson"
    stay two prompts, which a person may drop in the vetting file.
    """
    a, b = _words(first), _words(second)
    if not a or not b:
        return float(a == b)
    common = len(set(a) & set(b)) / len(set(a) | set(b))
    return max(common, SequenceMatcher(None, " ".join(a), " ".join(b), autojunk=False).ratio())


def without_near_duplicates(
    things: Iterable[Thing], prompt: Callable[[Thing], str], alike: float = ALIKE
) -> tuple[list[Thing], list[Thing]]:
    """(kept, dropped) in the given order: each is dropped that is `alike` to one kept before."""
    kept: list[Thing] = []
    dropped: list[Thing] = []
    for thing in things:
        again = any(likeness(prompt(thing), prompt(other)) >= alike for other in kept)
        (dropped if again else kept).append(thing)
    return kept, dropped


def _words(text: str) -> list[str]:
    words = [word.removesuffix("s") if len(word) > 3 else word for word in re.findall(r"[^\W_]+", text.lower())]
    return [word for word in words if word not in _FILLERS]
