"""What SAM2's automatic mask generator knows of each mask, computed from its logits.

transformers' own mask-generation pipeline returns boolean masks and predicted IoU only, dropping stability and
logits, which the paper's filter and soft blending need.
"""

from dataclasses import dataclass

import cv2
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.interfaces import Proposal

STABILITY_OFFSET = 1.0


@dataclass(frozen=True)
class Candidates:
    """N masks of one picture."""

    logits: Float[Tensor, "n h w"]  # as the network gives them, small
    predicted_iou: Float[Tensor, "n"]  # in [0, 1]
    stability: Float[Tensor, "n"]  # in [0, 1]
    area: Float[Tensor, "n"]  # share of the picture, in [0, 1]
    boxes: Float[Tensor, "n 4"]  # x, y, width, height [pixels]; zeros for an empty mask

    def select(self, index: Tensor) -> "Candidates":
        return Candidates(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    @staticmethod
    def cat(parts: "list[Candidates]") -> "Candidates":
        names = Candidates.__dataclass_fields__
        return Candidates(*(torch.cat([getattr(part, name) for part in parts]) for name in names))


def describe(
    logits: Float[Tensor, "n h w"], large: Float[Tensor, "n height width"], predicted_iou: Float[Tensor, "n"]
) -> Candidates:
    """Fields of masks given small and at the photo's size."""
    inside = large > 0
    return Candidates(
        logits, predicted_iou.clamp(0, 1), stability(large), inside.float().mean((1, 2)), boxes_of(inside)
    )


def stability(logits: Float[Tensor, "n height width"]) -> Float[Tensor, "n"]:
    """IoU of the masks cut at +1 and at -1; the first lies inside the second. 0 for a mask that is empty at -1."""
    strict = (logits > STABILITY_OFFSET).sum((1, 2))
    loose = (logits > -STABILITY_OFFSET).sum((1, 2))
    return strict / loose.clamp(min=1)


def boxes_of(inside: Bool[Tensor, "n height width"]) -> Float[Tensor, "n 4"]:
    """Smallest box around each mask: x, y, width, height [pixels]."""
    spans = [_span(inside.any(dim)) for dim in (1, 2)]  # columns, rows
    (x, width), (y, height) = spans
    return torch.stack((x, y, width, height), dim=1).float()


def _span(occupied: Bool[Tensor, "n length"]) -> tuple[Tensor, Tensor]:
    """First occupied index and number of indices to the last, 0 and 0 when none is."""
    marks = occupied.int()
    first = marks.argmax(1)
    last = marks.shape[1] - 1 - marks.flip(1).argmax(1)
    some = marks.any(1)
    return first * some, (last - first + 1) * some


def suppress(boxes: Float[Tensor, "n 4"], scores: Float[Tensor, "n"], overlap: float) -> list[int]:
    """Indices of boxes that no better one overlaps by more than `overlap` (IoU), best first."""
    if not len(boxes):
        return []
    # Scores are raised above its threshold, which drops boxes of score 0 otherwise.
    kept = cv2.dnn.NMSBoxes(boxes.tolist(), (1 + scores).tolist(), score_threshold=0.0, nms_threshold=overlap)
    return [int(index) for index in kept]


def proposal(logits: Float[Tensor, "height width"], predicted_iou: float) -> Proposal:
    """One mask at the photo's size as the framework wants it."""
    fields = describe(logits[None], logits[None], torch.tensor([predicted_iou]))
    return Proposal(
        soft_mask=logits.sigmoid(),
        area=float(fields.area),
        stability=float(fields.stability),
        predicted_iou=float(fields.predicted_iou),
        box=tuple(fields.boxes[0].tolist()),
    )
