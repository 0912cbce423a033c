"""On which photo words are found most surely, and whether the others confirm it: a thing is a thing
in all photos.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Proposal
from edit3r.kit.geometry.warping import warp

ASKED = 3  # photos that are looked at, at most
SURER = 1.2  # how many times as sure another photo must be to be taken in place of the first
SEES = 0.5  # share of a mask that a photo must show to say anything of it
# Overlap of what two photos mean from which they mean one thing, and below which they do not:
# between lies a thing that one of them takes with its plinth.
CONFIRMED, DENIED = 0.5, 0.2
# what is left of the confidence where a photo sees the place and finds nothing there
UNCONFIRMED = 0.5
UNSEEN = 0.8  # the same in comparison to others, where a photo does not see the place
CUT = 0.5  # the same for a thing whose outline is the photo's border

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
    best = max(weighed, key=lambda view: _confidence(weighed[view]))
    if _confidence(weighed[best]) <= SURER * _confidence(weighed[first]):
        best = first
    return best, weighed[best]


def _confidence(found: Found) -> float:
    return found[0].confidence if found else 0.0


def _weighed(view: int, found: Mapping[int, Found], shared: Shared) -> Found:
    """What a view shows, the likeliest first, less confident where the others see and do not
    confirm it.
    """
    others = [other for other in found if other != view]
    surfaces = [(found[other], shared(view, other)) for other in others]
    weighed = []
    for one in found[view]:
        overlaps = [
            None if surface is None else _overlap_there(one, there, *surface)
            for there, surface in surfaces
        ]
        confidence = one.confidence * _mean(map(_confirmed, overlaps))
        unseen = _mean(UNSEEN if overlap is None else 1.0 for overlap in overlaps)
        rank = confidence * unseen * (1 - (1 - CUT) * _on_border(one.soft_mask > 0.5))
        weighed.append((rank, replace(one, confidence=confidence)))
    weighed.sort(key=lambda ranked: -ranked[0])
    return tuple(one for _, one in weighed)


def _mean(factors: Iterable[float]) -> float:
    known = list(factors)
    return sum(known) / len(known) if known else 1.0


def _confirmed(overlap: float | None) -> float:
    """What is left of a confidence by the overlap with what another photo means; None: not seen."""
    if overlap is None:
        return 1.0
    share = (overlap - DENIED) / (CONFIRMED - DENIED)
    return UNCONFIRMED + (1 - UNCONFIRMED) * min(max(share, 0.0), 1.0)


def _overlap_there(
    one: Proposal,
    there: Found,
    grid: Float[Tensor, "height width 2"],
    same: Bool[Tensor, "height width"],
) -> float | None:
    """Largest overlap with what another view calls so; None where that does not see the place."""
    inside = one.soft_mask > 0.5
    seen = inside & same
    if not inside.any() or seen.sum() < SEES * inside.sum():
        return None
    largest = 0.0
    for other in there:
        moved = warp(other.soft_mask[None].to(grid), grid, padding="zeros")[0]
        both = (moved > 0.5) & same
        overlap = (both & seen).sum() / (both | seen).sum()
        largest = max(largest, float(overlap))
    return largest


def _on_border(inside: Bool[Tensor, "height width"]) -> float:
    """Share of a mask's outline that is the photo's border."""
    sides = (inside[0], inside[-1], inside[:, 0], inside[:, -1])
    on_border = sum(int(side.sum()) for side in sides)
    steps = (inside[1:] ^ inside[:-1]).sum() + (inside[:, 1:] ^ inside[:, :-1]).sum()
    return on_border / max(1, on_border + int(steps))
