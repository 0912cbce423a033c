"""What words mean to the detectors: one table of synonyms, and the names of their classes."""

from functools import cache
from pathlib import Path

DOGS = range(151, 269)  # ImageNet has 118 breeds


@cache
def lines_of(name: str) -> tuple[str, ...]:
    """The lines of a data file beside this module, in order, without its notes."""
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    return tuple(line for line in text.splitlines() if not line.startswith("#"))


COCO = lines_of("coco.txt")
SYNONYMS = dict(line.split(": ") for line in lines_of("synonyms.txt"))


def coco_classes(text: str) -> tuple[int, ...]:
    """Places in COCO of what a text names; () where COCO has no such thing."""
    return _classes(text, _by_name(tuple((name,) for name in COCO)))


def imagenet_classes(text: str) -> tuple[int, ...]:
    """Places in ImageNet's 1,000 classes of what a text names; () where it has no such thing."""
    names = _by_name(tuple(tuple(line.split(", ")) for line in imagenet_names()))
    return _classes(text, names | {"dog": tuple(DOGS)})


def imagenet_names() -> tuple[str, ...]:
    """A line of names that mean the same for each class of ImageNet, in order."""
    return lines_of("imagenet.txt")


@cache
def _by_name(classes: tuple[tuple[str, ...], ...]) -> dict[str, tuple[int, ...]]:
    """Places of the classes that a name means: those with that name, else those that end in it."""
    whole: dict[str, list[int]] = {}
    heads: dict[str, list[int]] = {}
    for place, names in enumerate(classes):
        for name in names:
            whole.setdefault(name, []).append(place)
        if " " in names[0]:
            heads.setdefault(names[0].split()[-1], []).append(place)
    return {name: tuple(places) for name, places in (heads | whole).items()}


def _classes(text: str, known: dict[str, tuple[int, ...]]) -> tuple[int, ...]:
    """The classes of the longest end of the text that means something: "old red mug" is a mug."""
    words = plain(text).split()
    for start in range(len(words)):
        for name in _forms(" ".join(words[start:])):
            names = [*SYNONYMS.get(name, "").split("/"), name]
            found = [place for one in names for place in known.get(one, ())]
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
