"""A segmenter held to its contract: asked like any, and named where its answer is none."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import PluginError
from edit3r.contract.interfaces import Marks, Proposal, Segmenter, Tracks
from edit3r.kit.checks import (
    check_answers,
    check_proposal,
    check_tracks,
    errors_named_after,
    named_after,
    where,
)

Image = Float[Tensor, "3 height width"]


class HeldSegmenter(Segmenter):
    """Asks another segmenter, and raises PluginError, which names it, for a broken promise."""

    def __init__(self, asked: Segmenter) -> None:
        self.asked = asked

    def propose(self, image: Image) -> tuple[Proposal, ...]:
        return self._several(image, lambda: self.asked.propose(image))

    def segment_marks(self, image: Image, marks: Marks) -> Proposal:
        with errors_named_after(self.asked, image):
            answer = self.asked.segment_marks(image, marks)
        check_proposal(self.asked, answer, image)
        return answer

    def readings(self, image: Image, marks: Marks) -> tuple[Proposal, ...]:
        proposals = self._several(image, lambda: self.asked.readings(image, marks))
        if not proposals:
            raise PluginError(
                f"{named_after(self.asked)} must read marks as something."
            )
        return proposals

    def ask(
        self,
        image: Image,
        clicks: Sequence[tuple[tuple[float, float], bool]],
        box: tuple[float, float, float, float] | None = None,
        before: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        with errors_named_after(self.asked, image):
            answer = self.asked.ask(image, clicks, box, before)
        if answer is not None:
            check_answers(self.asked, answer)
        return answer

    def segment_text(self, image: Image, text: str) -> tuple[Proposal, ...] | None:
        with errors_named_after(self.asked, image):
            answer = self.asked.segment_text(image, text)
        return None if answer is None else self._several(image, lambda: answer)

    def words_help(self) -> str:
        with errors_named_after(self.asked):
            return self.asked.words_help()

    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        with errors_named_after(self.asked, images, masks):
            answer = self.asked.track(images, masks)
        check_tracks(self.asked, answer, images, len(masks))
        return answer

    def _several(self, image: Image, ask: Callable[[], Any]) -> tuple[Proposal, ...]:
        """What `ask` answers, if it is any number of proposals."""
        with errors_named_after(self.asked, image):
            answer = ask()
        if not isinstance(answer, Sequence) or isinstance(answer, str):
            raise PluginError(
                f"{named_after(self.asked)} must return a tuple of {where(Proposal)}, got "
                f"{type(answer).__name__}."
            )
        for one in answer:
            check_proposal(self.asked, one, image)
        return tuple(answer)
