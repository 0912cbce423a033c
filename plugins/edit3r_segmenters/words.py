"""What words mean to the detectors: one table of synonyms, and the names of their classes."""

from functools import cache
from pathlib import Path


@cache
def lines_of(name: str) -> tuple[str, ...]:
    """The lines of a data file beside this module, in order, without its notes."""
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return tuple(line for line in text.splitlines() if not line.startswith("#"))


COCO = lines_of("coco.txt")
SYNONYMS = dict(line.split(": ") for line in lines_of("synonyms.txt"))


@cache
def _by_name() -> dict[str, tuple[int, ...]]:
    """Places of the classes that a name means: that with this name, else those that end in it."""
    heads: dict[str, tuple[int, ...]] = {}
    for place, name in enumerate(COCO):
        if " " in name:
            head = name.split()[-1]
            heads[head] = (*heads.get(head, ()), place)
    return heads | {name: (place,) for place, name in enumerate(COCO)}


def coco_classes(text: str) -> tuple[int, ...]:
    """Places in COCO of what the longest end of a text means; () where COCO has no such thing: "old
    red mug" is a mug.
    """
    words = plain(text).split()
    for start in range(len(words)):
        for name in _forms(" ".join(words[start:])):
            names = [*SYNONYMS.get(name, "").split("/"), name]
            found = [place for one in names for place in _by_name().get(one, ())]
            if found:
                return tuple(dict.fromkeys(found))
    return ()


def _forms(name: str) -> list[str]:
    """A name as it is, and as one of several: "cups" is "cup"."""
    forms = [name]
    if name.endswith("ies"):
        forms.append(name[:-3] + "y")
    if name.endswith(("ches", "shes", "xes", "sses")):
        forms.append(name[:-2])
    if name.endswith("s") and not name.endswith("ss"):
        forms.append(name[:-1])
    return forms


def plain(text: str) -> str:
    """A name without case, article and other filler: 'the whole picture' is 'picture'."""
    return " ".join(
        word
        for word in text.lower().split()
        if word not in ("the", "a", "an", "whole", "entire", "all")
    )
