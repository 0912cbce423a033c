"""Contract of a detector."""

import torch

from edit3r.interfaces import Detection, Detector
from edit3r.testing.contract import Contract
from edit3r.testing.scenes import photograph


class DetectorContract(Contract):
    """Boxes inside the picture, scores in [0, 1], best first; nothing found is an empty tuple."""

    kind = "detector"
    subject: Detector
    text: str = "the ball"  # what to look for
    image_size: tuple[int, int] = (72, 96)  # (height, width) [pixels]

    def test_detections_are_in_range_and_sorted(self) -> None:
        image = photograph(2, self.image_size).views.images[0, 0].to(self.device)
        self._check(image)

    def test_a_blank_picture_is_no_error(self) -> None:
        self._check(torch.full((3, *self.image_size), 0.5, device=self.device))

    def _check(self, image: torch.Tensor) -> None:
        found = self.call(f"detect({self.text!r})", self.subject.detect, image, self.text)
        kind = type(found).__name__
        self.require(isinstance(found, tuple), f"detect() returned a {kind}; return a tuple, () for none.")
        height, width = self.image_size
        for index, detection in enumerate(found):
            name = f"detection {index}"
            self.require(isinstance(detection, Detection), f"{name} is a {type(detection).__name__}; return Detection.")
            self.require(0 <= detection.score <= 1, f"{name}.score is {detection.score:.4g}; it must lie in [0, 1].")
            x, y, w, h = detection.box
            fits = x >= 0 and y >= 0 and w > 0 and h > 0 and x + w <= width + 1 and y + h <= height + 1
            self.require(fits, f"{name}.box is {detection.box} on {width}x{height}; it is (x, y, w, h) in pixels.")
        scores = [detection.score for detection in found]
        self.require(scores == sorted(scores, reverse=True), f"scores are {scores}; return the best first.")
