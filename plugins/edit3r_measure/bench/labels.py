"""What the photos of a scene show, and where: labels and boxes of a detector, masks around them."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.morphology import dilate_softly
from edit3r.interfaces import Detection, Detector, Segmenter

__all__ = ["VOCABULARY", "SceneLabels", "find_labels", "masks_of"]

_WORDS = """
person statue animal dog cat bird horse bear toy car bus truck bicycle motorcycle boat train house
building tower bridge door window wall fence stairs bench chair table sofa bed lamp shelf book
laptop screen cup bottle bowl plate vase flower plant tree bush rock sign fountain umbrella bag box
clock
"""

VOCABULARY = tuple(_WORDS.split())
"""Words that a detector is asked for unless the user gives others."""

SHARE_OF_VIEWS = 0.5
"""An object counts when at least this share of the photos shows it."""

LARGEST_SHARE = 0.7
"""Boxes over more of a picture than this name the place rather than a thing in it."""


@dataclass(frozen=True)
class SceneLabels:
    """Labels, most certain first, and the best box of each in every photo that shows it."""

    labels: tuple[str, ...]
    boxes: dict[str, tuple[Detection | None, ...]]  # by label, one per photo


def find_labels(
    images: Float[Tensor, "frame 3 height width"], detector: Detector, words: Sequence[str] = VOCABULARY, most: int = 8
) -> SceneLabels:
    """At most `most` objects that enough of the photos show, by their mean score."""
    area = images.shape[-2] * images.shape[-1]
    boxes = {word: tuple(_best(detector.detect(image, word), area) for image in images) for word in words}
    scores = {word: sum(box.score for box in own if box) / len(images) for word, own in boxes.items()}
    seen = [word for word, own in boxes.items() if sum(b is not None for b in own) >= SHARE_OF_VIEWS * len(images)]
    labels = tuple(sorted(seen, key=lambda word: -scores[word])[:most])
    return SceneLabels(labels, {label: boxes[label] for label in labels})


def masks_of(
    images: Float[Tensor, "view 3 height width"], boxes: Sequence[Detection | None], segmenter: Segmenter | None
) -> Float[Tensor, "view height width"] | None:
    """Masks around one object, a little larger than it; the boxes themselves without a segmenter.

    None when a view does not show the object: an edit confined to some of the views would be another edit.
    """
    if any(box is None for box in boxes):
        return None
    masks = [_mask(image, box, segmenter) for image, box in zip(images, boxes)]
    return dilate_softly(torch.stack(masks))


def _best(detections: Sequence[Detection], area: int) -> Detection | None:
    fit = [d for d in detections if d.box[2] * d.box[3] <= LARGEST_SHARE * area]
    return max(fit, key=lambda d: d.score, default=None)


def _mask(image: Float[Tensor, "3 height width"], found: Detection, segmenter: Segmenter | None) -> Tensor:
    height, width = image.shape[-2:]
    x, y, w, h = found.box
    if segmenter is not None:
        box = (max(0.0, x / width), max(0.0, y / height), min(1.0, w / width), min(1.0, h / height))
        return (segmenter.segment(image, box=box).soft_mask > 0.5).to(image.dtype)
    mask = image.new_zeros(height, width)
    mask[max(0, round(y)) : round(y + h), max(0, round(x)) : round(x + w)] = 1
    return mask
