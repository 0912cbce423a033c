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
    """What may be dropped and merged, and how merged Gaussians are shaped."""

    contribution: float = Field(0.02, ge=0)
    """drop a Gaussian whose blending weight sums to less over the pictures [pixels]"""
    harmonics: float = Field(1 / 255, ge=0, le=1)
    """change of a pixel up to which harmonics of higher degrees are dropped"""
    price: float = Field(0.005, ge=0)
    """squared error, summed over pixels, that may at most be made to save one Gaussian"""
    relative_price: float = Field(1, ge=0)
    """that error against the mean one of merging 2x2 pixels; at least a tenth of `price`"""
    gradient_share: float = Field(0.5, ge=0, le=1)
    """share of a linear change of colour that counts as error within a merged cell"""
    edge: float = Field(0.05, ge=0, le=1)
    """change of colour per pixel that surfaces out of place are taken to cause"""
    duplicate_depth: float = Field(0.02, ge=0, le=1)
    """relative difference of depth up to which two views show the same surface"""
    duplicate_colour: float = Field(0.06, ge=0, le=1)
    """difference of colour up to which two views show the same surface"""
    polish: int = Field(10, ge=0, le=1000)
    """most steps a view that bring the pictures back towards those of all Gaussians"""
    largest_cell: int = Field(5, ge=0, le=8)
    """merged cells have sides of at most 2^this pixels"""
    spread: float = Field(1.75, ge=1, le=4)
    """size of a merged Gaussian against the moments of its cell"""
    behind: float = Field(0.25, ge=0, le=2)
    """how far a merged Gaussian moves away from its camera [its largest scale]"""
