"""What several plugins ask of a segmenter: the mask in a box, and everything on an image."""

from dataclasses import dataclass

import cv2
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Box, MaskLogits, Proposal, Segmenter
from edit3r.contract.reporting import progress
from edit3r.kit import asking
from edit3r.kit.compute.outlines import soft_edged
from edit3r.kit.geometry.maps import size_of

STABILITY_OFFSET = 1.0  # logits
UNKNOWN_QUALITY = 0.5  # of a mask whose segmenter cannot tell it
SAME_BOX = 0.7  # overlap of boxes above which the better of two masks stays


@dataclass(frozen=True)
class AutomaticMask(Proposal):
    """One of all objects of an image, with the fields of SAM 2's automatic mask generator."""

    stability: float = 1.0  # in [0, 1]: overlap of the mask cut at logits +1 and -1
    predicted_iou: float = 1.0  # in [0, 1]: how good the segmenter believes it is


def mask_in_box(
    segmenter: Segmenter, image: Float[Tensor, "3 height width"], box: Box
) -> Float[Tensor, "height width"]:
    """The best mask for a box, soft, in [0, 1]."""
    answer = asking.masks(segmenter, image, (), box)
    best = 0 if answer.quality is None else int(answer.quality.argmax())
    return _softened(image, answer.logits[best])


def automatic_masks(
    segmenter: Segmenter,
    image: Float[Tensor, "3 height width"],
    points_per_side: int = 6,
    min_predicted_iou: float = 0.0,
    min_stability: float = 0.0,
) -> tuple[AutomaticMask, ...]:
    """What a grid of clicks finds, best first; of masks with nearly the same box the best, as SAM
    2's automatic mask generator has it.
    """
    steps = [(index + 0.5) / points_per_side for index in range(points_per_side)]
    places = [(x, y) for y in steps for x in steps]
    kept: list[tuple[Tensor, Tensor, Tensor]] = []
    for number, place in enumerate(places, 1):
        answer = asking.masks(segmenter, image, [(place, True)])
        logits, quality = answer.logits, quality_of(answer)
        stable = stability(logits)
        good = (quality >= min_predicted_iou) & (stable >= min_stability)
        good &= (logits > 0).flatten(1).any(1)
        kept.append((logits[good], quality[good].clamp(0, 1), stable[good]))
        progress("segmenting", number, len(places))
    logits, quality, stable = (torch.cat(parts) for parts in zip(*kept))
    return tuple(
        AutomaticMask(
            _softened(image, logits[index]),
            stability=float(stable[index]),
            predicted_iou=float(quality[index]),
        )
        for index in best_boxes(boxes_of(logits > 0), quality, SAME_BOX)
    )


def quality_of(answer: MaskLogits) -> Float[Tensor, "mask"]:
    """The IoU that each mask is expected to have; the same for all where nobody tells."""
    if answer.quality is None:
        return answer.logits.new_full((len(answer.logits),), UNKNOWN_QUALITY)
    return answer.quality


def stability(logits: Float[Tensor, "n height width"]) -> Float[Tensor, "n"]:
    """IoU of the masks cut at +1 and at -1; the first lies inside the second. 0 for a mask that is
    empty at -1.
    """
    strict = (logits > STABILITY_OFFSET).sum((1, 2))
    loose = (logits > -STABILITY_OFFSET).sum((1, 2))
    return strict / loose.clamp(min=1)


def boxes_of(inside: Tensor) -> Float[Tensor, "n 4"]:
    """Smallest box around each bool mask `[n, h, w]`: x, y, width, height [pixels]; zeros for an
    empty one.
    """
    boxes = [cv2.boundingRect(mask.byte().numpy(force=True)) for mask in inside]
    return torch.tensor(boxes, dtype=torch.float32).reshape(-1, 4)


def best_boxes(
    boxes: Float[Tensor, "n 4"], scores: Float[Tensor, "n"], overlap: float
) -> list[int]:
    """Non-maximum suppression: indices of boxes that no better one overlaps by more than `overlap`,
    best first.
    """
    if not len(boxes):
        return []
    # Scores are raised above its threshold, which drops boxes of score 0 otherwise.
    kept = cv2.dnn.NMSBoxes(
        boxes.tolist(),
        (1 + scores).tolist(),
        score_threshold=0.0,
        nms_threshold=overlap,
    )
    return [int(index) for index in kept]


def enlarged(
    logits: Float[Tensor, "*n h w"], size: tuple[int, int]
) -> Float[Tensor, "*n height width"]:
    """Small masks at a photo's size; they stay logits."""
    flat = logits.flatten(0, -3)[:, None]
    large = F.interpolate(flat.float(), size, mode="bilinear", align_corners=False)
    return large[:, 0].unflatten(0, logits.shape[:-2])


def _softened(
    image: Float[Tensor, "3 height width"], logits: Float[Tensor, "h w"]
) -> Float[Tensor, "height width"]:
    """A mask at the image's size, its soft edge following the image's own."""
    large = enlarged(logits[None].to(image), size_of(image))[0]
    return soft_edged(image, (large.sigmoid() > 0.5).numpy(force=True))
