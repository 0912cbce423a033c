"""Boxes of 80 everyday things by NanoDet (RangiLyu 2020), a small network in torch."""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

import edit3r
from edit3r.contract.interfaces import Detection, Detector
from edit3r.kit.compute.perceptual import IMAGENET_MEAN, IMAGENET_STD
from edit3r.kit.segmenting import best_boxes
from edit3r.kit.weights.find import find
from edit3r_segmenters import NANODET
from edit3r_segmenters.tfjs import TfjsGraph
from edit3r_segmenters.words import COCO, coco_classes

MIN_SCORE = 0.1  # of a box
SAME_BOX = 0.5  # overlap above which two boxes are one thing
SIDE = 416  # of the network's input [pixels]
BINS = 11  # a distance to a side of the box is a distribution over 0 to 10 strides
MEAN = np.float32(255 * np.array(IMAGENET_MEAN[::-1]))  # BGR
STD = np.float32(255 * np.array(IMAGENET_STD[::-1]))
LEVELS = (
    ("Identity", "Identity_3"),
    ("Identity_1", "Identity_4"),
    ("Identity_2", "Identity_5"),
)
"""The graph's outputs for each size of things: scores of the classes, distances to the sides."""


class CocoDetector(Detector):
    """Knows the words of COCO and their synonyms; for other words it finds nothing, for no words
    all that it knows.
    """

    def __init__(self, settings: edit3r.Settings) -> None:
        super().__init__(settings)
        self._graph = TfjsGraph(find(NANODET) / "nanodet.json")

    def knows(self, text: str) -> bool:
        return bool(coco_classes(text))

    @torch.no_grad()
    def detect(
        self, image: Float[Tensor, "3 height width"], text: str
    ) -> tuple[Detection, ...]:
        classes = coco_classes(text) if text else tuple(range(len(COCO)))
        if not classes:
            return ()
        height, width = image.shape[-2:]
        boxes, scores = self._boxes(image)
        score, which = scores[:, list(classes)].max(1)
        boxes = boxes.clamp(0, 1) * torch.tensor([width, height, width, height])
        likely = score >= MIN_SCORE
        likely &= (boxes[:, 2:] > boxes[:, :2]).all(1)  # not on the rim
        boxes, score, which = boxes[likely], score[likely], which[likely]
        boxes[:, 2:] -= boxes[:, :2]
        found = []
        for index in best_boxes(boxes, score, SAME_BOX):
            label = COCO[classes[int(which[index])]]
            box = tuple(boxes[index].tolist())
            found.append(Detection(label, float(score[index]), box))
        return tuple(found)

    def _boxes(
        self, image: Float[Tensor, "3 height width"]
    ) -> tuple[Float[Tensor, "n 4"], Float[Tensor, "n 80"]]:
        """Corners [shares of the image's sides] and scores of all boxes.

        The network sees the image twice: squashed to its square, and in its own shape with a rim.
        Each finds things that the other does not.
        """
        pixels = image.detach().cpu().float().clamp(0, 1).permute(1, 2, 0).numpy()
        height, width = pixels.shape[:2]
        longer = max(height, width)
        rim = ((0, longer - height), (0, longer - width), (0, 0))
        squashed, scores = self._seen(pixels)
        padded, more = self._seen(np.pad(pixels, rim))
        share = torch.tensor([longer / width, longer / height] * 2)
        return torch.cat((squashed, padded * share)), torch.cat((scores, more))

    def _seen(
        self, pixels: np.ndarray
    ) -> tuple[Float[Tensor, "n 4"], Float[Tensor, "n 80"]]:
        """Corners [shares of the picture's sides] and scores of all boxes on one picture."""
        square = cv2.resize(pixels[:, :, ::-1] * 255, (SIDE, SIDE))
        read = torch.from_numpy((square - MEAN) / STD).permute(2, 0, 1)[None]
        outputs = [name for level in LEVELS for name in level]
        values = self._graph.run({"input_1": read.float()}, outputs)
        boxes = [_corners(values[place][0]) for place in (1, 3, 5)]
        scores = [values[place][0] for place in (0, 2, 4)]
        return torch.cat(boxes) / SIDE, torch.cat(scores)


def _corners(distances: Float[Tensor, "n 44"]) -> Float[Tensor, "n 4"]:
    """Boxes of one level (generalised focal loss, Li et al. 2020, eq. 5): a cell's middle and the
    expected distances to the four sides.
    """
    count = len(distances)
    cells = round(count**0.5)
    stride = SIDE / cells
    shares = distances.view(count, 4, BINS).softmax(-1)
    left, top, right, bottom = (shares @ torch.arange(float(BINS)) * stride).T
    index = torch.arange(count)
    x = (index % cells + 0.5) * stride
    y = (index // cells + 0.5) * stride
    return torch.stack((x - left, y - top, x + right, y + bottom), 1)
