"""What a word names on an image: boxes of the best detector at hand, and how sure each is.

A detector's score does not say whether the image shows the thing at all. How sure an answer of
NanoDet is was read off words of photos that show the thing and of photos that do not
(docs/notes/selecting.md); that of Grounding DINO is its score.
"""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor

from edit3r import build, default_registry
from edit3r.contract.interfaces import Detection, PixelBox, Proposal, Segmenter
from edit3r.kit import asking
from edit3r.kit.segmenting import mask_in_box
from edit3r.kit.weights.find import at_hand
from edit3r_segmenters.words import coco_classes

DETECTORS = {
    "grounding-dino": ("grounding-dino", "grounding-dino-tiny"),
    "coco": ("nanodet",),
}
"""Detectors and the weights of each; the first that is at hand is asked first."""
SHARE = 0.45  # of the best box's score that other things of its name must reach
PART = 0.7  # share of a box inside a better one from which it is only a part of that
MAX_THINGS = 8
SLOPE, HALF = 2.2, 0.42  # of a logistic curve over the logarithm of NanoDet's score


def named(
    image: Float[Tensor, "3 height width"], text: str, segmenter: Segmenter
) -> tuple[Proposal, ...] | None:
    """What the text names, best first: the segmenter's masks of a detector's boxes. None for words
    that no usable detector knows.
    """
    detector = _knowing(text)
    if detector is None:
        return None
    detections = asking.detect(build("detector", detector), image, text)
    height, width = image.shape[-2:]
    found = []
    for one in _distinct(detections)[:MAX_THINGS]:
        x, y, across, down = one.box
        box = (x / width, y / height, across / width, down / height)
        sure = _confidence(one.score) if detector == "coco" else one.score
        found.append(Proposal(mask_in_box(segmenter, image, box), sure))
    return tuple(found)


def _knowing(text: str) -> str | None:
    """The first usable detector that knows the words; None: there is none.

    Those that others brought come before NanoDet, which knows 80 words.
    """
    best, last = DETECTORS
    others = (offer.qualified_name for offer in default_registry().offers("detector"))
    brought = [one for one in others if one.partition(":")[2] not in DETECTORS]
    for detector in (best, *brought, last):
        if usable(detector) and (detector != last or coco_classes(text)):
            return detector
    return None


def usable(detector: str) -> bool:
    """Whether a detector and its weights are on this machine."""
    registry = default_registry()
    if detector in DETECTORS:
        return registry.ready("detector", detector, *DETECTORS[detector])
    offer = registry.find("detector", detector)
    ready = all(at_hand(weights) is not None for weights in offer.component.weights)
    return ready and not registry.missing(offer)


def _distinct(detections: Sequence[Detection]) -> list[Detection]:
    """Those that score well beside the best, without parts of what a better one holds."""
    kept: list[Detection] = []
    for one in detections:
        likely = one.score >= SHARE * detections[0].score
        if likely and all(_inside(one.box, other.box) < PART for other in kept):
            kept.append(one)
    return kept


def _inside(box: PixelBox, other: PixelBox) -> float:
    """Share of a box that another one holds."""
    (x, y, width, height), (left, top, across, down) = box, other
    shared_width = min(x + width, left + across) - max(x, left)
    shared_height = min(y + height, top + down) - max(y, top)
    return max(0.0, shared_width) * max(0.0, shared_height) / (width * height)


def _confidence(score: float) -> float:
    return float(1 / (1 + (HALF / max(score, 1e-6)) ** SLOPE))
