"""What is marked on one photo."""

from dataclasses import dataclass

from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.contract.interfaces import Box, Selection
from edit3r_select.cues import Place


@dataclass(frozen=True)
class Marks:
    """What a user pointed at on one photo; places are x and y in [0, 1]."""

    positive: tuple[Place, ...] = ()  # on the object
    negative: tuple[Place, ...] = ()  # on what is not the object
    # x, y, width, height around it
    box: Box | None = None
    # where it is expected, in [0, 1], as from another view
    prior: Float[Tensor, "height width"] | None = None
    # where the prior says anything, such as what the other view shows too; None: everywhere
    known: Bool[Tensor, "height width"] | None = None
    # steps from the best candidate to a larger one (> 0) or a smaller one (< 0)
    larger: int = 0
    # places along what was drawn over the object
    stroke: tuple[Place, ...] = ()

    @property
    def says_where(self) -> bool:
        """Whether a click, a stroke or a box says where the object is."""
        return bool(self.positive or self.stroke or self.box)


def marks_on(selection: Selection, view: int) -> Marks:
    """Clicks, strokes and box of one photo."""
    drawn = [places for on, places in selection.strokes if on == view]
    return Marks(
        positive=tuple((x, y) for on, x, y in selection.positive if on == view),
        negative=tuple((x, y) for on, x, y in selection.negative if on == view),
        box=selection.boxes.get(view),
        stroke=tuple((x, y) for places in drawn for x, y in places),
    )
