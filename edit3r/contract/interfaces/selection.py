"""What a user chose on the photos, and selectors, which find it on all of them."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.errors import InputError
from edit3r.contract.instructions import Box
from edit3r.contract.interfaces.reconstruction import Geometry
from edit3r.contract.types import Views

# confidence under which the run asks whether the right thing was found; docs/notes/selecting.md
SURE = 0.63
MOST_GROWN = 100_000  # pixels that an outline may move
BACKGROUND = "background"  # the words for everything but what stands out
WAYS = ("given", "region", "marked", "words", "guess", "geometry", "pictures")
"""How a thing came to be selected on a photo.

On the photo itself: its mask was `given`; a `region` was drawn exactly; clicks, strokes or a box
`marked` it; its name was found there (`words`); or nobody knew the words, and what stands out was
taken (`guess`). Carried over from other photos: by `geometry`, or without it by what the `pictures`
show. A photo that has none of it says "not found" instead.
"""
SHARES = "expected shares of its sides, 0 to 1 (x / width, y / height)"
ASK = "click on it (--point X,Y), or draw a box (--box) or a mask (--mask)"
"""What to do where nobody knows which thing is meant."""


def candidate_flags(numbers: Sequence[int]) -> str:
    """What takes one of these candidates on the command line: "--candidate 1, 2 or 3"."""
    *first, last = map(str, numbers)
    return "--candidate " + (f"{', '.join(first)} or {last}" if first else last)


@dataclass(frozen=True)
class Selection:
    """Everything a user marked; places are x (right) and y (down) in [0, 1] of a view."""

    # clicks on the object: view, x, y
    positive: tuple[tuple[int, float, float], ...] = ()
    # clicks beside it, on what is not wanted
    negative: tuple[tuple[int, float, float], ...] = ()
    # a box around the object, one for each view at most
    boxes: Mapping[int, Box] = field(default_factory=dict)
    # what a brush added to the mask of a view, in [0, 1]
    added: Mapping[int, Float[Tensor, "height width"]] = field(default_factory=dict)
    # what an eraser took from it, in [0, 1]
    removed: Mapping[int, Float[Tensor, "height width"]] = field(default_factory=dict)
    # finished masks of views, taken as they are
    masks: Mapping[int, Float[Tensor, "height width"]] = field(default_factory=dict)
    # the object's name, such as "bike": looked for where nothing is marked; beside a click it
    # helps to tell the object from its parts
    words: str = ""
    # which one of several: "left", "big", "red", "all"
    qualifiers: tuple[str, ...] = ()
    several: bool = False  # True: a plural, so every one that is found surely is taken
    # which candidate is taken: 1 is the likeliest, 2 the next
    candidate: int = 1
    # above 0: so many steps to larger candidates ("the whole car"); below 0: to smaller ones
    larger: int = 0
    grow: float = 0.0  # pixels by which the outline moves outwards; inwards below 0
    inverted: bool = False  # True: everything but the object
    # lines drawn over the object: view, and the places x, y along the line
    strokes: tuple[tuple[int, tuple[tuple[float, float], ...]], ...] = ()
    # boxes whose whole content is selected, whatever it is: view, box
    regions: tuple[tuple[int, Box], ...] = ()

    def __post_init__(self) -> None:
        """Raise InputError for marks that lie on no photo, and for what is no mark."""
        self._check_numbers()
        for place in (*self.positive, *self.negative, *self._drawn()):
            view, x, y = _numbers_of(place, "a point is (view, x, y)", 3)
            if not (0 <= x <= 1 and 0 <= y <= 1):
                raise InputError(
                    f"a point lies outside photo {view + 1}: ({x:.3g}, {y:.3g}); {SHARES}."
                )
        for view, box in (*self.boxes.items(), *self.regions):
            x, y, width, height = _numbers_of(box, "a box is (x, y, width, height)", 4)
            # a comparison with what is no number is False
            if not (0 <= x < x + width <= 1.001 and 0 <= y < y + height <= 1.001):
                raise InputError(
                    f"the box on photo {view + 1} must lie within the photo and have a size above "
                    f"0; {SHARES}."
                )

        self._check_views()
        self._check_masks()

    def _check_views(self) -> None:
        for view in self.views:
            if not isinstance(view, int):
                raise InputError(
                    f"a mark on view {view!r}; expected its number, from 0 on."
                )

    def _check_numbers(self) -> None:
        if not isinstance(self.candidate, int) or self.candidate < 1:
            raise InputError(
                f"candidate: got {self.candidate!r}, expected 1 for the likeliest, 2 for the next."
            )
        if not isinstance(self.larger, int):
            raise InputError(f"larger: got {self.larger!r}, expected whole steps.")
        if not abs(self.grow) <= MOST_GROWN:  # False for what is no number
            raise InputError(
                f"grow: got {self.grow:g}, expected pixels from -{MOST_GROWN} to {MOST_GROWN}."
            )
        if not isinstance(self.words, str):
            raise InputError(f"words: got {self.words!r}, expected text.")

    def _check_masks(self) -> None:
        sizes = set()
        kinds = {"masks": self.masks, "added": self.added, "removed": self.removed}
        for name, masks in kinds.items():
            for view, mask in masks.items():
                if not isinstance(mask, Tensor) or mask.ndim != 2:
                    raise InputError(
                        f"{name}: got a {type(mask).__name__} of shape "
                        f"{list(getattr(mask, 'shape', []))} for view {view!r}, expected a tensor "
                        "[height, width] in [0, 1]."
                    )
                low, high = map(float, mask.aminmax()) if mask.numel() else (0, 0)
                if low < 0 or high > 1:
                    raise InputError(
                        f"{name}: got values from {low:.4g} to {high:.4g} for view {view!r}, "
                        "expected [0, 1]."
                    )
                sizes.add(tuple(mask.shape))
        if len(sizes) > 1:
            listed = ", ".join(f"{width}x{height}" for height, width in sorted(sizes))
            raise InputError(
                f"masks of several sizes ({listed}); expected all of the photos' size."
            )

    def _drawn(self) -> Iterator[tuple[Any, ...]]:
        """View, x and y of every place along a stroke."""
        for stroke in self.strokes:
            view, places = _numbers_of(stroke, "a stroke is (view, ((x, y), ...))", 2)
            if not len(places):
                raise InputError(f"a stroke on photo {view + 1} has no place.")
            yield from ((view, *place) for place in places)

    @property
    def says_where(self) -> bool:
        """Whether any mark says where the object is. Clicks beside it and the eraser do not."""
        looked_for = (self.positive, self.strokes, self.boxes)
        return any((*looked_for, self.masks, self.added, self.regions))

    @property
    def views(self) -> tuple[int, ...]:
        """Views with any mark, those with the most exact ones first: finished masks, then boxes,
        brush and regions, then strokes and clicks, then the eraser.
        """
        drawn = [stroke[0] for stroke in self.strokes]
        clicked = [place[0] for place in (*self.positive, *self.negative)]
        exact = (*self.added, *(view for view, _ in self.regions))
        said = (*self.masks, *self.boxes, *exact, *drawn, *clicked, *self.removed)
        return tuple(dict.fromkeys(said))


@dataclass(frozen=True)
class Candidate:
    """A candidate: one thing that the marks or words may mean, such as a wheel or the whole car."""

    view: int
    mask: Float[Tensor, "height width"]  # soft, in [0, 1], on that view
    score: float  # in [0, 1]: how likely this one is meant
    number: int  # that takes it, as `Selection.candidate` or --candidate; 1 is the likeliest


@dataclass(frozen=True)
class Selected:
    """What was selected on the views of one scene."""

    # soft, in [0, 1]; 0 everywhere in a view where nothing was found
    masks: Float[Tensor, "view 1 height width"]
    # for each view one of `WAYS`, or "not found"
    how: tuple[str, ...]
    # sentences for the user, which were also sent to `edit3r.contract.reporting`
    warnings: tuple[str, ...] = ()
    # in [0, 1]: how likely the right thing was found; None: it was marked exactly, or nobody knows
    confidence: float | None = None
    # all candidates, the one that was taken included; the likeliest first
    candidates: tuple[Candidate, ...] = ()
    # the number of the candidate that was taken; 0: none, where one is asked for
    taken: int = 1
    called: str = ""  # the name that was asked for, such as "left cup"
    # True: what is marked has that name; False: the name was found elsewhere; None: not checked
    fits: bool | None = None
    # False: nothing here knows the words, so what stands out is taken
    knows_words: bool = True

    @property
    def is_sure(self) -> bool:
        """Whether it was marked exactly, or found surely enough."""
        return self.confidence is None or self.confidence >= SURE

    def select(self, indices: Sequence[int]) -> "Selected":
        """The same on the views at `indices` only."""
        return replace(
            self,
            masks=self.masks[list(indices)],
            how=tuple(self.how[view] for view in indices),
            candidates=tuple(
                replace(one, view=indices.index(one.view))
                for one in self.candidates
                if one.view in indices
            ),
        )


class Selector(Configured, ABC):
    """Finds what is selected, by marks or by words, on all photos of a scene."""

    @abstractmethod
    def select(
        self, views: Views, selection: Selection, geometry: Geometry | None = None
    ) -> Selected:
        """Find the object on all views of one scene (batch 1).

        `geometry` tells where one view's pixels lie in another; None where the photos could not be
        placed, so that only the pictures tell. The masks obey every mark, and `selection.grow` and
        `selection.inverted` are applied to them.

        For words that are unknown or not found, what stands out is taken, with "guess" in `how`.

        Raises:
            InputError: For marks on a view that does not exist, and of a kind that this selector
                cannot read.
        """


def _numbers_of(value: Any, meaning: str, count: int) -> tuple[Any, ...]:
    if not hasattr(value, "__len__") or len(value) != count:
        raise InputError(f"{meaning}, got {value!r}.")
    return tuple(value)
