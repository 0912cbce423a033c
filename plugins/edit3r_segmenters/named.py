"""What a word names on an image, by small detectors, and how surely.

A word of COCO is looked up by NanoDet, any other word of ImageNet by its activation map. Their
scores do not say whether the image shows the thing at all: the right word can score low, and a
wrong one high. How sure an answer is was read off words of photos that show the thing and of
photos that do not (docs/selecting.md).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r import build, default_registry
from edit3r.contract.interfaces import Detection, Marks, Proposal, as_proposal
from edit3r_segmenters.words import coco_classes, imagenet_classes

DETECTORS = {"coco": "nanodet", "imagenet": "efficientnet-lite0"}
"""The small detectors and the weights of each."""
SHARE = 0.45  # of the best box's score that other things of its name must reach
PART = 0.7  # share of a box inside a better one from which it is only a part of that
MAX_THINGS = 8
PEAKS = 8  # places of the activation at which masks are asked for
LEAST_PEAK = 0.3  # activation of such a place beside the highest one
APART = 0.12  # distance of such places [longer sides of the image]
LOOKED_AT = 6  # masks that the classifier looks at one by one
AROUND = 0.4  # what it sees beyond a mask's box [longer sides of the box]
QUALITY = 0.2  # what a mask's own quality counts beside the activation that it holds
LEAST_SIDE = 12  # half a side of what it sees, at least [pixels]
LIKENESS = 0.05  # what the classifier's logit of its picture counts
# Logistic curves of the confidence over the logarithm of a score: slope, and score of 1/2
COCO_CURVE = (2.2, 0.42)
IMAGENET_CURVE = (0.6, 0.06)

Answer = Callable[[Float[Tensor, "3 height width"], Marks], Proposal]
Box = tuple[float, float, float, float]
Place = tuple[float, float]
Ask = Callable[..., tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Namer:
    """Looks words up; `answer` gives the mask of a box, `ask` a network's masks of a click."""

    answer: Answer
    ask: Ask | None = None

    def find(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...] | None:
        """What the text names, best first; None for words that no usable detector knows."""
        found = None
        if coco_classes(text) and usable("coco"):
            found = self._by_boxes(image, text)
        if not found and imagenet_classes(text) and usable("imagenet"):
            found = self._by_activation(image, text)
        return found

    def _by_boxes(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...]:
        detections = build("detector", "coco").detect(image, text)
        height, width = image.shape[-2:]
        found = []
        for one in _distinct(detections)[:MAX_THINGS]:
            x, y, across, down = one.box
            box = (x / width, y / height, across / width, down / height)
            proposal = self.answer(image, Marks(box=box))
            confidence = _confidence(one.score, *COCO_CURVE)
            found.append(replace(proposal, confidence=confidence))
        return tuple(found)

    def _by_activation(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Proposal, ...]:
        detector = build("detector", "imagenet")
        _, probability, heat = detector.activation(image, text)
        confidence = _confidence(probability, *IMAGENET_CURVE)
        if self.ask is None:
            found = self.answer(image, Marks(positive=tuple(_peaks(heat)[:1])))
            return (replace(found, confidence=confidence),)
        masks, quality = self._masks_at(image, _peaks(heat))
        held = [_held(heat, mask) for mask in (masks > 0).numpy()]
        scores = torch.tensor(held) + QUALITY * quality
        best = scores.argsort(descending=True)[:LOOKED_AT]
        pictures = [_around(image, masks[index] > 0) for index in best]
        alike = detector.likeness(pictures, text)
        chosen = masks[best[int((scores[best] + LIKENESS * alike).argmax())]]
        return (
            replace(as_proposal(chosen.sigmoid().to(image)), confidence=confidence),
        )

    def _masks_at(
        self, image: Float[Tensor, "3 height width"], places: Sequence[Place]
    ) -> tuple[Float[Tensor, "mask height width"], Float[Tensor, "mask"]]:
        """Logits of all masks that the network has for a click on each place, and their quality."""
        answers = [self.ask(image, [(place, True)]) for place in places]
        logits = torch.from_numpy(np.concatenate([some for some, _ in answers]))
        quality = torch.from_numpy(np.concatenate([good for _, good in answers]))
        size = image.shape[-2:]
        large = torch.nn.functional.interpolate(logits[None], size, mode="bilinear")[0]
        some = (large > 0).any(-1).any(-1)
        return large[some], quality[some]


def _distinct(detections: Sequence[Detection]) -> list[Detection]:
    """Those that score well beside the best, without parts of what a better one holds."""
    kept: list[Detection] = []
    for one in detections:
        likely = one.score >= SHARE * detections[0].score
        if likely and all(_inside(one.box, other.box) < PART for other in kept):
            kept.append(one)
    return kept


def _inside(box: Box, other: Box) -> float:
    """Share of a box that another one holds."""
    (x, y, width, height), (left, top, across, down) = box, other
    shared_width = min(x + width, left + across) - max(x, left)
    shared_height = min(y + height, top + down) - max(y, top)
    return max(0.0, shared_width) * max(0.0, shared_height) / (width * height)


def usable(detector: str) -> bool:
    """Whether a small detector and its weights are on this machine."""
    return default_registry().ready("detector", detector, DETECTORS[detector])


def knows(text: str) -> bool:
    """Whether a small detector would know the words, were its weights here."""
    return bool(coco_classes(text) or imagenet_classes(text))


def _peaks(heat: np.ndarray) -> list[Place]:
    """The places of the highest activation [shares of the sides], apart from each other."""
    left, found = heat.copy(), []
    height, width = heat.shape
    while len(found) < PEAKS and left.max() >= LEAST_PEAK * heat.max() > 0:
        row, column = np.unravel_index(left.argmax(), left.shape)
        found.append(((column + 0.5) / width, (row + 0.5) / height))
        radius = round(APART * max(height, width))
        cv2.circle(left, (int(column), int(row)), radius, -1.0, cv2.FILLED)
    return found


def _around(
    image: Float[Tensor, "3 height width"], mask: Bool[Tensor, "height width"]
) -> Float[Tensor, "3 rows columns"]:
    """The part of an image around a mask, as nearly square as it goes."""
    rows, columns = mask.any(1).nonzero()[:, 0], mask.any(0).nonzero()[:, 0]
    middle = [int(one[0] + one[-1]) // 2 for one in (rows, columns)]
    longer = max(int(one[-1] - one[0]) + 1 for one in (rows, columns))
    half = max(LEAST_SIDE, round((0.5 + AROUND) * longer))
    top, left = (max(0, place - half) for place in middle)
    return image[:, top : middle[0] + half, left : middle[1] + half]


def _held(heat: np.ndarray, mask: np.ndarray) -> float:
    """How much of the activation a mask holds, and how densely."""
    if not mask.any():
        return 0.0
    return float(heat[mask].mean() * np.sqrt(heat[mask].sum() / heat.sum()))


def _confidence(score: float, slope: float, half: float) -> float:
    return float(1 / (1 + (half / max(score, 1e-6)) ** slope))
