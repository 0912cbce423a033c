"""The segmenter `auto`: SAM2 by transformers or as ONNX where it can be used, else GrabCut."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from jaxtyping import Float
from pydantic import model_validator
from torch import Tensor

from edit3r import build, default_registry
from edit3r.contract.interfaces import (
    Box,
    Click,
    MaskLogits,
    Proposal,
    Segmenter,
    Tracks,
)
from edit3r.contract.reporting import say, warn
from edit3r_segmenters.grabcut import GrabCutSegmenter
from edit3r_segmenters.named import named


class AutoSegmenter(Segmenter):
    """Masks and tracks are those of what is picked; words are those of `grabcut` (the subject, the
    sky, the ground), all others the picked one's masks of a detector's boxes.

    What is picked becomes a setting, so that answers of another pick are not reused.
    """

    class Settings(GrabCutSegmenter.Settings):
        pick: Literal["best", "sam2", "sam2-onnx", "grabcut"] = "best"
        """best: the first that is at hand"""

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
        self.grabcut = build(
            "segmenter", "grabcut", **settings.model_dump(exclude={"pick"})
        )
        self.picked: Segmenter = self.grabcut
        if settings.pick == "sam2":
            self.picked = build("segmenter", "sam2")
        elif settings.pick != "grabcut":
            self.picked = build("segmenter", "sam-onnx")

    def masks(
        self,
        image: Float[Tensor, "3 height width"],
        clicks: Sequence[Click],
        box: Box | None = None,
        before: Float[Tensor, "h w"] | None = None,
    ) -> MaskLogits:
        say("segmenter.picked", self.settings.pick)
        if self.settings.pick == "grabcut":
            warn(
                "objects are told by their colours alone (GrabCut); small networks find whole "
                "things far more often: edit3r weights get essentials"
            )
        return self.picked.masks(image, clicks, box, before)

    def words(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        known = self.grabcut.words(image, text)
        return named(image, text, self) if known is None else known

    def track(
        self,
        images: Float[Tensor, "view 3 height width"],
        masks: Float[Tensor, "object height width"],
    ) -> Tracks | None:
        return self.picked.track(images, masks)


def _best() -> str:
    """The best that can be used here and now."""
    registry = default_registry()
    if registry.ready("segmenter", "sam2", "sam2", "sam2-tiny"):
        return "sam2"
    is_small = registry.ready("segmenter", "sam-onnx", "sam2-onnx")
    return "sam2-onnx" if is_small else "grabcut"
