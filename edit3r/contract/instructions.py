"""What a sentence asks for, as the editors get it with their request.

The reader of a run (`edit3r.contract.interfaces.Reader`) makes these from the prompt. A sentence is
a row of instructions, each about one thing: "paint the door green and remove the bin" is two.
"""

from dataclasses import dataclass, replace
from typing import Literal

Action = Literal["paint", "look", "remove", "other"]
"""What an instruction does: change colours, give a look, take something away, or anything else."""

Scope = Literal["named", "marked", "whole", "background", "region"]
Finish = Literal["", "matte", "metallic"]
EVERY = frozenset(("all", "both", "every", "each", "two", "three", "four", "five"))
"""Words of `Target.qualifiers` that mean every thing of its name."""

FLOOD = frozenset(
    ("whole", "entire", "completely", "fully", "entirely", "totally", "wholly")
)
"""Words of `Target.qualifiers` that want all of a thing painted, its neutral parts too."""

BENEATH = "under it"
"""`Target.of` of what the instruction's own thing stands on, whose colour it may take."""

Box = tuple[float, float, float, float]
"""x, y, width, height [shares of a view's sides]."""


@dataclass(frozen=True)
class Colour:
    """A colour by its name."""

    name: str  # as the sentence says it
    rgb: tuple[float, float, float]  # sRGB in [0, 1]


@dataclass(frozen=True)
class Target:
    """What an instruction is about."""

    # named: by `name`; marked: what the user marked, or what stands out; whole: all of the image;
    # background: all but the main thing; region: `box` of the picture, such as its left half
    scope: Scope = "marked"
    name: str = ""  # "motorcycle", "old door"
    # what picks it among several: "left", "big", "red", "all"
    qualifiers: tuple[str, ...] = ()
    of: str = ""  # the whole that it is a part of: "tank of the motorcycle"
    part: Colour | None = None  # only its pixels near this colour
    # of a region, on the first photo: left, top, width, height [shares of its sides]
    box: Box | None = None
    # a plural without a number: "chairs", of which all that are surely found are taken
    several: bool = False
    unknown: tuple[str, ...] = ()  # words of the name that the reader does not know

    def __str__(self) -> str:
        if self.scope == "region":
            return f"{self.name} of the picture"
        if self.scope == "whole" and self.part is not None:
            return f"what is {self.part.name}"
        plain = {"marked": "it", "named": ""}.get(self.scope, self.scope)
        words = [
            *self.qualifiers,
            plain if self.scope == "whole" else self.name or plain,
        ]
        text = " ".join(words) + (f" ({self.of})" if self.of else "")
        return text if self.part is None else f"{text} where it is {self.part.name}"


ChangeKind = Literal[
    "paint",
    "tint",
    "brightness",
    "contrast",
    "saturation",
    "warmth",
    "greyscale",
    "sepia",
    "invert",
    "random",
]
"""paint: one colour, with its shading; tint: towards a colour; random: drawn by the seed."""


@dataclass(frozen=True)
class Change:
    """One change of the colours of a thing, such as "blue" or "20 % darker"."""

    kind: ChangeKind
    colour: Colour | None = None  # of paint and tint
    # of paint: the thing whose colour it takes; `colour` is then measured on the photos
    like: Target | None = None
    material: str = ""  # of paint: what it shall look like, such as "gold"
    finish: Finish = ""  # of paint: how its light shall be
    # of paint, "a darker green": darker than the thing is now (-1), or lighter (1)
    than_now: Literal[-1, 0, 1] = 0
    # 1: clearly visible; the sign is the direction where there is one
    amount: float = 1.0

    def __str__(self) -> str:
        if self.like is not None:
            hue = "colour" if self.like.part is None else self.like.part.name
            target = replace(self.like, part=None)
            return f"the {hue} of {target}" + _measured(self.colour)
        if self.colour is not None and self.kind == "paint":
            return f"{self.finish} {self.colour.name}".strip()
        if self.colour is not None:
            return f"more {self.colour.name}"
        if self.kind in ("greyscale", "sepia", "invert", "random"):
            return {"invert": "inverted", "random": "random colours"}.get(
                self.kind, self.kind
            )
        return f"{self.kind} {self.amount:+.2g}"


def _measured(colour: Colour | None) -> str:
    """The colour that was read off a thing, as people can say it: " (#8a7f70)"."""
    if colour is None:
        return ""
    return f" (#{''.join(f'{round(255 * value):02x}' for value in colour.rgb)})"


@dataclass(frozen=True)
class Instruction:
    """One thing, and what shall happen to it."""

    action: Action
    target: Target
    changes: tuple[Change, ...] = ()  # of the action paint, in order
    look: str = ""  # of the action look: its word, such as "sketch"
    without: tuple[Target, ...] = ()  # what stays as it is
    text: str = ""  # the words of the sentence that ask for it
    unread: tuple[str, ...] = ()  # those among them that nobody understood
    left_out: tuple[str, ...] = ()  # understood, but nobody here can do it: "glossy"

    def fault(self) -> str:
        """What does not hold together, after "one "; "" for nothing."""
        if self.action == "paint" and not self.changes:
            return "paints, and names no change"
        if self.action == "look" and not self.look:
            return "gives a look, and names none"
        for change in self.changes:
            if change.kind in ("paint", "tint") and not (change.colour or change.like):
                return f"is to {change.kind}, and names no colour"
        likes = (change.like for change in self.changes if change.like is not None)
        for target in (self.target, *self.without, *likes):
            if (target.scope == "region") != (target.box is not None):
                return "is about a place of the picture without a box, or has a box without one"
        return ""

    def __str__(self) -> str:
        what = ", ".join(map(str, self.changes)) or self.look or self.action
        if self.action == "other":
            return repr(self.text)
        kept = "".join(f" without {target}" for target in self.without)
        left = f" ({', '.join(self.left_out)} is left out)" if self.left_out else ""
        return f"{self.target}{kept}: {what}{left}"
