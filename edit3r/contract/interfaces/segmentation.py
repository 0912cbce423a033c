"""Segmenters and detectors: which pixels belong to the thing that somebody means."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.instructions import Box

Place = tuple[float, float]
"""x and y in [0, 1] of an image."""
Click = tuple[Place, bool]
"""A place, and whether the object is there."""
PixelBox = tuple[float, float, float, float]
"""x, y, width, height [pixels]; what a person marks is a `Box` [shares of the sides]."""
SUBJECT = "subject"
"""The word for what stands out most on a photo."""


@dataclass(frozen=True)
class MaskLogits:
    """Every mask that marks on an image may mean, in any order; a segmenter gives at least one."""

    # > 0 inside; of any size, covering the image
    logits: Float[Tensor, "mask h w"]
    # in [0, 1]: the IoU that each is expected to have; None: the segmenter cannot tell
    quality: Float[Tensor, "mask"] | None = None


@dataclass(frozen=True)
class Proposal:
    """One thing that words may mean on an image."""

    soft_mask: Float[Tensor, "height width"]  # in [0, 1]
    confidence: float = 1.0  # in [0, 1]: how likely it is what is meant

    @property
    def area(self) -> float:
        """Share of the image that it covers, in [0, 1]."""
        return float((self.soft_mask > 0.5).float().mean())

    @property
    def box(self) -> PixelBox:
        """Around it; zeros where it is empty."""
        inside = self.soft_mask > 0.5
        rows, columns = inside.any(1).nonzero()[:, 0], inside.any(0).nonzero()[:, 0]
        if not len(rows):
            return (0.0, 0.0, 0.0, 0.0)
        left, top = float(columns[0]), float(rows[0])
        return (left, top, float(columns[-1]) + 1 - left, float(rows[-1]) + 1 - top)


@dataclass(frozen=True)
class Tracks:
    """Objects followed through views: index r is the same object everywhere."""

    logits: Float[Tensor, "view object height width"]  # > 0: inside
    # False: lost in that view, its logits are all <= 0
    present: Bool[Tensor, "view object"]


class Segmenter(Configured, ABC):
    """Finds what marks or words mean on one image.

    Which of the masks is taken, and where it lies on other photos, is the selector's work.
    """

    @abstractmethod
    def masks(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[Click],
        box: Box | None = None,
        before: Float[Tensor, "h w"] | None = None,
    ) -> MaskLogits:
        """Every mask that the marks may mean, at least one; `image` is sRGB in [0, 1].

        Clicks, a box or both are given. `before` are the logits of the answer that the last click
        corrects: of any size, covering the image, > 0 inside.
        """

    def words(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """What `text` (such as "the bike") names, best first.

        Empty where the image does not show it; None for words that the segmenter does not know.
        `SUBJECT` asks for what stands out most.
        """
        return None

    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks | None:
        """Follow objects, given by soft masks on view 0, through all views; None where it cannot
        follow any.

        An object that is not found in a view is reported as lost there.
        """
        return None


@dataclass(frozen=True)
class Detection:
    """One box that a text names."""

    label: str
    score: float  # in [0, 1]
    box: PixelBox


class Detector(Configured, ABC):
    """Finds what a text names."""

    @abstractmethod
    def detect(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Detection, ...]:
        """Boxes of `text` (such as "the bike"), best first; empty when there is none.

        An empty text asks for all that the detector knows by name, where it can list them.
        """
