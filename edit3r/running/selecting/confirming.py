"""On which photo words are found most surely, and whether the others confirm it: a thing is a thing
in all photos.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Proposal
from edit3r.kit.geometry.warping import warp

ASKED = 3  # photos that are looked at, at most
SURER = 1.2  # how many times as sure another photo must be to be taken in place of the first
SEES = 0.5  # share of a mask that a photo must show to say anything of it
CONFIRMED = 0.5  # overlap from which two photos mean the same thing
UNCONFIRMED = 0.5  # what is left of the surety where a photo sees the place and finds nothing there

Found = tuple[Proposal, ...]
Surface = tuple[
    Float[Tensor, "height width 2"],
    Bool[Tensor, "height width"],
]
Shared = Callable[[int, int], Surface | None]
"""Where the pixels of one view lie in another, and whether both show one surface; None: unknown."""


def surest(found: Mapping[int, Found], first: int, shared: Shared) -> tuple[int, Found]:
    """The view to begin with, and what the words name there, the surest first.

    `found` holds what they name on each view that was asked. Another view than `first` is taken
    where it is clearly surer.
    """
    weighed = {view: _weighed(view, found, shared) for view in found}
    best = max(weighed, key=lambda view: _surety(weighed[view]))
    if _surety(weighed[best]) <= SURER * _surety(weighed[first]):
        best = first
    return best, weighed[best]


def _surety(found: Found) -> float:
    return found[0].surety if found else 0.0


def _weighed(view: int, found: Mapping[int, Found], shared: Shared) -> Found:
    """What a view shows, with less surety for what the others see and do not confirm."""
    others = [other for other in found if other != view]
    surfaces = {other: shared(view, other) for other in others}
    weighed = [
        replace(one, surety=one.surety * UNCONFIRMED)
        if any(
            surface is not None and _denied(one, found[other], *surface)
            for other, surface in surfaces.items()
        )
        else one
        for one in found[view]
    ]
    return tuple(sorted(weighed, key=lambda one: -one.surety))


def _denied(
    one: Proposal,
    there: Found,
    grid: Float[Tensor, "height width 2"],
    same: Bool[Tensor, "height width"],
) -> bool:
    """Whether a view sees the place of a thing and calls nothing there so."""
    inside = one.soft_mask > 0.5
    seen = inside & same
    if not inside.any() or seen.sum() < SEES * inside.sum():
        return False
    for other in there:
        moved = warp(other.soft_mask[None].to(grid), grid, padding="zeros")[0]
        both = (moved > 0.5) & same
        if (both & seen).sum() >= CONFIRMED * (both | seen).sum():
            return False
    return True
