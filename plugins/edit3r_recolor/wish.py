"""What a prompt asks for, once it is read."""

from dataclasses import dataclass
from typing import Literal

Scope = Literal["object", "everything", "background"]
Adjustment = Literal["brightness", "contrast", "saturation", "warmth", "greyscale", "sepia", "invert"]


@dataclass(frozen=True)
class Paint:
    """Give a region one colour, keeping its shading and texture."""

    colour: str  # as the prompt names it
    rgb: tuple[float, float, float]  # sRGB in [0, 1]


@dataclass(frozen=True)
class Tint:
    """Move all colours of a region towards one, as in "bluer"."""

    colour: str
    rgb: tuple[float, float, float]
    amount: float  # share of the way, in (0, 1]


@dataclass(frozen=True)
class Adjust:
    """Change one property of all colours of a region."""

    what: Adjustment
    amount: float = 1.0  # 1: clearly visible; the sign is the direction where there is one


@dataclass(frozen=True)
class Sample:
    """Draw the paper's composite transform from the run's seed."""


Step = Paint | Tint | Adjust | Sample


@dataclass(frozen=True)
class Wish:
    """A prompt that was understood: what to do, in order, and where."""

    steps: tuple[Step, ...]
    scope: Scope
    subject: tuple[str, ...] = ()  # words for the object, such as ("bike",); nothing here can look them up
