"""A segmenter whose every answer is checked against its contract."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import PluginError
from edit3r.contract.interfaces import (
    Box,
    Click,
    MaskLogits,
    Proposal,
    Segmenter,
    Tracks,
)
from edit3r.kit.checks import (
    check_masks,
    check_proposal,
    check_tracks,
    errors_named_after,
    named_after,
    where,
)

Image = Float[Tensor, "3 height width"]


class ValidatedSegmenter(Segmenter):
    """Asks another segmenter, and raises PluginError, which names it, for a broken promise."""

    def __init__(self, asked: Segmenter) -> None:
        self.asked = asked

    def masks(
        self,
        image: Image,
        clicks: Sequence[Click],
        box: Box | None = None,
        before: Float[Tensor, "h w"] | None = None,
    ) -> MaskLogits:
        with errors_named_after(self.asked, image):
            answer = self.asked.masks(image, clicks, box, before)
        check_masks(self.asked, answer)
        return answer

    def words(self, image: Image, text: str) -> tuple[Proposal, ...] | None:
        with errors_named_after(self.asked, image):
            answer = self.asked.words(image, text)
        if answer is None:
            return None
        if not isinstance(answer, Sequence) or isinstance(answer, str):
            raise PluginError(
                f"{named_after(self.asked)} must return a tuple of {where(Proposal)}, got "
                f"{type(answer).__name__}."
            )
        for one in answer:
            check_proposal(self.asked, one, image)
        return tuple(answer)

    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks | None:
        with errors_named_after(self.asked, images, masks):
            answer = self.asked.track(images, masks)
        if answer is not None:
            check_tracks(self.asked, answer, images, len(masks))
        return answer
