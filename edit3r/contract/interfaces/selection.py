"""What a user chose on the photos, and selectors, which find it on all of them."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.errors import InputError
from edit3r.contract.interfaces.reconstruction import Geometry
from edit3r.contract.interfaces.segmentation import Marks
from edit3r.contract.types import Views

Box = tuple[float, float, float, float]
"""x, y, width, height [shares of a view's sides]."""
SURE = 0.63  # confidence under which what was found is a question
MOST_GROWN = 100_000  # pixels that an outline may move
BACKGROUND = "background"  # words for all but what stands out
WAYS = ("given", "region", "marked", "words", "guess", "geometry", "pictures")
"""How a thing is found on a photo; "not found" where it is not."""
SHARES = "expected shares of its sides, 0 to 1 (x / width, y / height)"
ASK = "click on it (--point X,Y), or draw a box (--box) or a mask (--mask)"
"""What to do where nobody knows which thing is meant."""


@dataclass(frozen=True)
class Selection:
    """Everything a user marked; places are x (right) and y (down) in [0, 1] of a view."""

    # clicks on the object: view, x, y
    positive: tuple[tuple[int, float, float], ...] = ()
    # clicks on what is not the object
    negative: tuple[tuple[int, float, float], ...] = ()
    boxes: Mapping[int, Box] = field(default_factory=dict)  # view: x, y, width, height
    # brush in [0, 1], by view
    added: Mapping[int, Float[Tensor, "height width"]] = field(default_factory=dict)
    # eraser, likewise
    removed: Mapping[int, Float[Tensor, "height width"]] = field(default_factory=dict)
    # finished masks, by view
    masks: Mapping[int, Float[Tensor, "height width"]] = field(default_factory=dict)
    # what is meant, such as "bike"; looked up where no mark says it all
    words: str = ""
    which: tuple[str, ...] = ()  # picks among several: "left", "big", "red", "all"
    several: bool = False  # the words are a plural: all that are sure are taken
    # True: what words found unsurely or not at all is refused; else it is taken as a question
    sure: bool = False
    # 1: the most likely reading of clicks, strokes, boxes and words; 2: the next
    reading: int = 1
    # steps to a larger reading of clicks, boxes and words (> 0), or to a smaller one (< 0)
    larger: int = 0
    grow: float = 0.0  # moves the outline outwards [pixels], inwards where negative
    inverted: bool = False  # True: all but the object is meant
    # lines drawn over the object: view, and places x, y along the line
    strokes: tuple[tuple[int, tuple[tuple[float, float], ...]], ...] = ()
    # boxes that are taken exactly, whatever lies in them: view, box
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
        if not isinstance(self.reading, int) or self.reading < 1:
            raise InputError(
                f"reading: got {self.reading!r}, expected 1 for the most likely, 2 for the next."
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
        """Whether any mark says where the object is; one that says where not is none."""
        looked_for = (self.positive, self.strokes, self.boxes)
        return any((*looked_for, self.masks, self.added, self.regions))

    def marks_on(self, view: int) -> Marks:
        """Clicks, strokes and box of one view."""
        drawn = [places for on, places in self.strokes if on == view]
        return Marks(
            positive=_places(self.positive, view),
            negative=_places(self.negative, view),
            box=self.boxes.get(view),
            stroke=tuple((x, y) for places in drawn for x, y in places),
        )

    @property
    def views(self) -> tuple[int, ...]:
        """Views that carry any mark, in the order in which they say where the object is."""
        drawn = [stroke[0] for stroke in self.strokes]
        clicked = [place[0] for place in (*self.positive, *self.negative)]
        exact = (*self.added, *(view for view, _ in self.regions))
        said = (*self.masks, *self.boxes, *exact, *drawn, *clicked, *self.removed)
        return tuple(dict.fromkeys(said))


@dataclass(frozen=True)
class Reading:
    """One thing that clicks, strokes, a box or words may mean."""

    view: int
    mask: Float[Tensor, "height width"]  # soft, in [0, 1], on that view
    score: float  # in [0, 1]: how likely it is what is meant
    number: int  # of `Selection.reading` and of the flag --reading


@dataclass(frozen=True)
class Selected:
    """What was selected on the views of one scene."""

    # soft, in [0, 1]; 0 everywhere in a view where nothing was found
    masks: Float[Tensor, "view 1 height width"]
    # by view, one of `WAYS`, or "not found"
    how: tuple[str, ...]
    # sentences for the user, also sent to `edit3r.contract.reporting`
    warnings: tuple[str, ...] = ()
    # in [0, 1]: how likely it is what was meant; None: marked exactly, or nobody can tell
    confidence: float | None = None
    # what else may be meant: the most likely first, the one that was taken among them
    readings: tuple[Reading, ...] = ()
    taken: int = 1  # the number of that one
    called: str = ""  # what was looked for, as people say it: "left cup"
    # whether words name what was marked; None: nobody looked, knows them or found them
    fits: bool | None = None

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
            readings=tuple(
                replace(one, view=indices.index(one.view))
                for one in self.readings
                if one.view in indices
            ),
        )


class Selector(Configured, ABC):
    """Finds what is selected, by marks or by words, on all photos of a scene."""

    @abstractmethod
    def select(
        self, views: Views, selection: Selection, geometry: Geometry | None = None
    ) -> Selected:
        """Select in one scene (batch 1).

        `geometry` is that of the views where somebody could read it and it can be trusted; without
        it masks are carried by what the pictures show. The masks obey the marks, and are those of
        `selection.grow` and `selection.inverted`.

        Words that nobody knows or finds are a question: what stands out, "guess" in `how`. Raises
        InputError for marks on no photo or of a sort that it does not read, and for what is unsure
        where `selection.sure`.
        """


def _numbers_of(value: Any, meaning: str, count: int) -> tuple[Any, ...]:
    if not hasattr(value, "__len__") or len(value) != count:
        raise InputError(f"{meaning}, got {value!r}.")
    return tuple(value)


def _places(
    points: tuple[tuple[int, float, float], ...], view: int
) -> tuple[tuple[float, float], ...]:
    """x and y of the points on one view."""
    return tuple((x, y) for on, x, y in points if on == view)
