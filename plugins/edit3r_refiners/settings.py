"""What a user may ask of `simplify`: how many Gaussians, and how much the images may change."""

from typing import Any, Literal

from pydantic import Field

from edit3r.contract.settings import Settings

Budget = Literal["auto", "all"] | int
"""How many Gaussians may be left: those the scene requires, all of them, or a number."""


def parse_budget(value: Any) -> Budget:
    """`"auto"`, `"all"`, or a number of at least 1, perhaps as text; else a ValueError."""
    if value in ("auto", "all"):
        return value
    try:
        number = int(str(value))
    except ValueError:
        number = 0
    if number < 1 or isinstance(value, bool):
        raise ValueError("expected auto, all or a number of at least 1")
    return number


def passes(budget: Budget, most: int | None = None) -> list[int | None]:
    """List the numbers to simplify to, one after the other; None stands for what the scene
    requires.

    `most` is a limit that holds on top of the budget.
    """
    asked: list[int | None] = []
    if budget != "all":
        asked = [budget if isinstance(budget, int) else None]
    return asked if most is None else [*asked, most]


class SimplifySettings(Settings):
    """What may be dropped and merged."""

    price: float = Field(0.005, ge=0)
    """squared error, summed over pixels, that may at most be made to save one Gaussian"""
    relative_price: float = Field(1, ge=0)
    """that error against the mean one of merging 2x2 pixels; at least a tenth of `price`"""
    duplicate_colour: float = Field(0.06, ge=0, le=1)
    """difference of colour up to which two views show the same surface"""
    polish: int = Field(10, ge=0, le=1000)
    """most steps a view that bring the pictures back towards those of all Gaussians"""
