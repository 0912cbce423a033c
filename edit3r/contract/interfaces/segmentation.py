"""Segmenters and detectors: which pixels belong to the thing that somebody means."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.errors import InputError
from edit3r.contract.reporting import warn

MAX_POINTS = 6  # of a stroke, that stand for it


@dataclass(frozen=True)
class Proposal:
    """One object on one image, with the fields that SAM2's automatic mask generator gives.

    A segmenter without learned weights fills `stability` and `predicted_iou` with stand-ins and
    says so in its summary.
    """

    soft_mask: Float[Tensor, "height width"]  # in [0, 1]
    area: float  # share of the image covered by soft_mask > 0.5, in [0, 1]
    stability: float  # in [0, 1]: overlap of the mask under two thresholds
    predicted_iou: float  # in [0, 1]: how good the mask believes it is
    box: tuple[float, float, float, float]  # x, y, width, height [pixels]
    confidence: float = 1.0  # in [0, 1]: how likely it is what is meant


@dataclass(frozen=True)
class Tracks:
    """Objects followed through views: index r is the same object everywhere."""

    logits: Float[Tensor, "view object height width"]  # > 0: inside
    # False: lost in that view, its logits are all <= 0
    present: Bool[Tensor, "view object"]


@dataclass(frozen=True)
class Marks:
    """What a user pointed at on one image; places are x and y in [0, 1]."""

    positive: tuple[tuple[float, float], ...] = ()  # on the object
    negative: tuple[tuple[float, float], ...] = ()  # on what is not the object
    # x, y, width, height around it
    box: tuple[float, float, float, float] | None = None
    # where it is expected, in [0, 1], as from another view
    prior: Float[Tensor, "height width"] | None = None
    # where the prior says anything, such as what the other view shows too; None: everywhere
    known: Bool[Tensor, "height width"] | None = None
    # steps from the best reading of the marks to a larger one (> 0) or a smaller one (< 0)
    larger: int = 0
    # places along what was drawn over the object
    stroke: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        places = np.array([*self.positive, *self.negative, *self.stroke]).ravel()
        if not np.isfinite([*places, *(self.box or ())]).all():
            raise InputError("a click or box is not made of numbers between 0 and 1.")

    @property
    def drawn(self) -> tuple[tuple[float, float], ...]:
        """Some places of the stroke, evenly along it."""
        if len(self.stroke) <= MAX_POINTS:
            return tuple(dict.fromkeys(self.stroke))
        chosen = np.linspace(0, len(self.stroke) - 1, MAX_POINTS).round().astype(int)
        return tuple(dict.fromkeys(self.stroke[index] for index in chosen))

    @property
    def inside(self) -> tuple[tuple[float, float], ...]:
        """All places that lie on the object."""
        return (*self.drawn, *self.positive)


class Segmenter(Configured, ABC):
    """Finds objects on one image and follows them through other views of the scene."""

    @abstractmethod
    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        """All candidate objects, most salient first."""

    def segment(
        self,
        image: Float[Tensor, "3 height width"],
        points: Sequence[tuple[float, float]] = (),
        box: tuple[float, float, float, float] | None = None,
    ) -> Proposal:
        """The object at `points` (x, y in [0, 1]) or in `box` (x, y, width, height in [0, 1]).

        A segmenter implements this or, to read more than that, `segment_marks`.
        """
        if type(self).segment_marks is Segmenter.segment_marks:
            name = type(self).__name__
            raise NotImplementedError(
                f"{name} implements neither segment nor segment_marks"
            )
        if not points and box is None:
            raise InputError(
                "segment: give at least one point, or a box, on the object."
            )
        return self.segment_marks(image, Marks(tuple(points), box=box))

    def segment_marks(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> Proposal:
        """The object that `marks` describe; they hold a positive point, a box or a prior.

        A segmenter that does not implement this reads positive points and the box only; a prior
        alone is then the answer itself.
        """
        if marks.prior is not None and not marks.inside and marks.box is None:
            return as_proposal(marks.prior)
        if marks.negative:
            name = type(self).__name__
            warn(
                f"segmenter {name} reads no negative points; erase what is too much instead."
            )
        if marks.larger:
            name = type(self).__name__
            warn(
                f"segmenter {name} knows one reading of a click, none larger or smaller."
            )
        return self.segment(image, marks.inside, marks.box)

    def readings(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> tuple[Proposal, ...]:
        """What `marks` may mean, the most likely first, each as sure as it is likely.

        The first is what `segment_marks` answers.
        """
        return (self.segment_marks(image, marks),)

    def ask(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[tuple[tuple[float, float], bool]],
        box: tuple[float, float, float, float] | None = None,
        before: Float[np.ndarray, "height width"] | None = None,
    ) -> tuple[Float[np.ndarray, "n h w"], Float[np.ndarray, "n"]] | None:
        """All masks that a network has for clicks (x, y in [0, 1], and whether the object is
        there), a box, and the logits of its answer `before` the last click; None where it has no
        such answers, so that `readings` are all there is.

        Returns logits of any size, which cover the image, and the IoU that each mask is expected
        to have, in [0, 1].
        """
        return None

    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """What `text` (such as "the bike") names, best first.

        Empty when the image does not show it; None for words that the segmenter does not know.
        """
        return None

    def words_help(self) -> str:
        """What a user can do where `segment_text` is None: a clause such as "fetch the weights"."""
        return ""

    @abstractmethod
    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        """Follow objects, given by soft masks on view 0, through all views.

        An object that is not found in a view is reported as lost there.
        """


def as_proposal(mask: Float[Tensor, "height width"]) -> Proposal:
    """A mask that somebody gave, as a proposal that is sure of itself."""
    inside = mask > 0.5
    rows = inside.any(1).nonzero()[:, 0]
    columns = inside.any(0).nonzero()[:, 0]
    box = (0.0, 0.0, 0.0, 0.0)
    if len(rows):
        left, top = float(columns[0]), float(rows[0])
        box = (left, top, float(columns[-1]) + 1 - left, float(rows[-1]) + 1 - top)
    return Proposal(mask, float(inside.float().mean()), 1.0, 1.0, box)


@dataclass(frozen=True)
class Detection:
    """One box that a text names."""

    label: str
    score: float  # in [0, 1]
    box: tuple[float, float, float, float]  # x, y, width, height [pixels]


class Detector(Configured, ABC):
    """Finds what a text names."""

    @abstractmethod
    def detect(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Detection, ...]:
        """Boxes of `text` (such as "the bike"), best first; empty when there is none.

        An empty text asks for all that the detector knows by name, where it can list them.
        """
