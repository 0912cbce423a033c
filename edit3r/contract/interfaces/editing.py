"""2D editors, and what some of them can do beyond `edit`.

An editor that can do more inherits the small interface for it beside `Editor`; whoever needs the
ability asks with `isinstance`.
"""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.component import Configured
from edit3r.contract.instructions import Instruction
from edit3r.contract.types import EditRequest, Views

if TYPE_CHECKING:
    from edit3r.contract.interfaces.reconstruction import Matcher


class Editor(Configured, ABC):
    """Changes photos as an instruction says.

    Keeps number, size and cameras of the views; same seed, same result. It need not honour
    `request.masks`: the pipeline composites the result with them, so pixels outside stay bit-equal
    whatever the editor does.
    """

    @abstractmethod
    def edit(self, views: Views, request: EditRequest) -> Views:
        """Return the edited views, images in [0, 1].

        Raises PromptError for an instruction that the editor cannot carry out.
        """

    def understands(self, instruction: Instruction) -> bool:
        """Whether the editor can carry out this instruction; one that takes any sentence says True.

        A run without `--editor` takes the first that declares the instruction's action
        (`Component.actions`) and understands the instruction.
        """
        return True

    def widened(
        self,
        regions: Float[Tensor, "instruction batch view height width"],
        images: Float[Tensor, "batch view 3 height width"],
    ) -> Float[Tensor, "instruction batch view height width"]:
        """What the editor has to change for things under `regions`, such as their shadows too."""
        return regions


class EditsRegions:
    """An editor that changes the regions of its instructions and nothing else.

    The run finds the things that the sentence names and hands over `request.regions`.
    """

    def instruction_of_nothing(self) -> Instruction | None:
        """What an empty prompt asks of this editor; None where it needs a sentence.

        Raises PromptError where settings lack what it would ask.
        """
        return None


class ChangesShape:
    """An editor whose edits add or remove things.

    The geometry is then read from the edited views, not from the photos.
    """


class HidesThings(ABC):
    """An editor that can hide what nobody shall see again, such as a face."""

    @abstractmethod
    def hides(self, instruction: Instruction) -> bool:
        """Whether the instruction hides its thing for good.

        The run then takes the edited pixels for the photo's own, in all that it keeps and writes,
        and hands over a region with a hard outline, a few pixels wider than the thing. `edit` must
        leave nothing of the region from which it could be reconstructed. Raises PromptError where
        settings of the editor would leave some of it visible.
        """


class StartsFromImages(ABC):
    """An editor that can begin from other images than the photos (Instruct-NeRF2NeRF)."""

    @abstractmethod
    def edit_from(
        self,
        views: Views,
        start: Float[Tensor, "batch view 3 height width"],
        request: EditRequest,
        strength: float,
    ) -> Views:
        """Edit `views`, beginning from the images `start` of them.

        `strength` in [0, 1] says how little of `start` stays. A diffusion editor adds noise to
        `start` at `strength` of the way and removes it with `views` and the prompt as conditions
        (Instruct-NeRF2NeRF, section 4.2).
        """


class GivesAttention(ABC):
    """An editor that tells where its edit looks (EditSplat)."""

    @abstractmethod
    def attention(
        self, views: Views, request: EditRequest
    ) -> Float[Tensor, "batch view height width"]:
        """Cross-attention of the prompt's words on each view; any scale, at least 0."""


class ConditionedOnDepth(ABC):
    """An editor that reads depth from its part `matcher`; a caller may replace it (GaussCtrl)."""

    # how many views, from the first, all others look at; 0: each by itself
    references: int
    matcher: "Matcher"
