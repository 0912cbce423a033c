"""What is selected on, and what is found on each photo: the data of selecting."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Candidate, Geometry, Segmenter
from edit3r.kit.cache import fingerprint
from edit3r.kit.geometry.warping import surfaces_apart

CARRIED = ("geometry", "pictures", "not found")
"""How a mask comes to a photo that has none of its own."""
SAME_SURFACE = 0.04  # relative difference in depth within which two photos show one
FAINT = 0.01  # a probability below this is none: such pixels keep their exact values

Mask = Float[Tensor, "height width"]
Surface = tuple[Float[Tensor, "height width 2"], Bool[Tensor, "height width"]]
"""Where the pixels of one photo lie in another, and whether both show one surface."""


@dataclass(frozen=True)
class OnPhoto:
    """What is selected on one photo."""

    mask: Mask  # soft, in [0, 1]
    how: str  # one of `edit3r.contract.interfaces.selection.WAYS`, or "not found"

    @property
    def inside(self) -> Bool[Tensor, "height width"]:
        return self.mask > 0.5

    @property
    def is_own(self) -> bool:
        return self.how not in CARRIED


Found = Mapping[int, OnPhoto]
"""By photo."""


@dataclass(frozen=True)
class Named:
    """What words mean, or what stands out where they mean nothing."""

    found: Found = field(default_factory=dict)
    confidence: float | None = None  # in [0, 1]; None: nothing was named
    least: float = 1.0  # confidence from which it is found on another photo too
    candidates: tuple[Candidate, ...] = ()
    warnings: tuple[str, ...] = ()
    each: bool = False  # True: each photo shows its own, so that photos do not vote
    knows_words: bool = True  # False: nothing here knows the words


@dataclass(frozen=True)
class Photos:
    """Photos of one scene, who answers marks on one, and where they were taken."""

    images: Float[Tensor, "view 3 height width"]
    segmenter: Segmenter
    geometry: Geometry | None = None  # batch 1
    intrinsics: Float[Tensor, "1 view 3 3"] | None = None

    @property
    def count(self) -> int:
        return len(self.images)

    def shared(
        self, view: int, source: int, tolerance: float = SAME_SURFACE
    ) -> Surface | None:
        """Where the pixels of `view` lie in `source`; None where geometry does not know."""
        geometry, pair = self.geometry, [view, source]
        if geometry is None or self.intrinsics is None:
            return None
        if not geometry.registered[0, pair].all():
            return None
        grid, apart = _apart(self._places, *pair)
        return grid, apart < tolerance

    @cached_property
    def _places(self) -> "_Hashed":
        assert self.geometry is not None and self.intrinsics is not None
        places = self.geometry.depths[0], self.intrinsics[0], self.geometry.c2w[0]
        return _Hashed(fingerprint(places), places)


@dataclass(frozen=True)
class _Hashed:
    """Depths, intrinsics and poses of all views, compared by their fingerprint alone."""

    fingerprint: str
    places: tuple[Tensor, Tensor, Tensor] = field(compare=False)


@lru_cache(maxsize=24)
def _apart(known: _Hashed, view: int, source: int) -> tuple[Tensor, Tensor]:
    """Clicks follow each other on the same photos."""
    return surfaces_apart(*(one[[view, source]] for one in known.places))


def overlap(one: Mask, other: Mask) -> float:
    """Intersection over union of two soft masks."""
    first, second = one > 0.5, other > 0.5
    return float((first & second).sum() / (first | second).sum().clamp(min=1))


def clean(mask: Mask, like: Tensor) -> Mask:
    """A mask in [0, 1], exactly 0 where it is faint."""
    mask = mask.to(like).clamp(0, 1)
    return torch.where(mask < FAINT, 0, mask)
