"""The detector's contract finds every way of breaking it."""

import pytest

from edit3r.contract.interfaces import Detection, Detector
from edit3r_testing import DetectorContract


class Fixed(Detector):
    """Answers with what it was given; None fails on a picture without contrast."""

    def __init__(self, answer):
        self.answer = answer

    def detect(self, image, text):
        if self.answer is None:
            return (Detection(text, 1 / (image.std() > 0).item(), (0, 0, 1, 1)),)
        return self.answer


GOOD = Detection("ball", 0.7, (10, 10, 20, 20))
IN_RANGE, BLANK = (
    "test_detections_are_in_range_and_sorted",
    "test_a_blank_image_is_no_error",
)
CASES = {
    "a list": ([GOOD], IN_RANGE, "return tuple"),
    "a tuple of boxes": (((1, 2, 3, 4),), IN_RANGE, "interfaces.Detection, got tuple"),
    "a percentage": (
        (Detection("ball", 70, (1, 1, 2, 2)),),
        IN_RANGE,
        "return score in [0, 1], got 70",
    ),
    "a box of corners": (
        (Detection("ball", 0.7, (90, 60, 96, 70)),),
        IN_RANGE,
        "(x, y, width, height) in pixels",
    ),
    "worst first": (
        (Detection("ball", 0.1, (1, 1, 2, 2)), GOOD),
        IN_RANGE,
        "return the best first",
    ),
    "an error on nothing": (None, BLANK, "raised ZeroDivisionError"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_detector_broken_by(case, complaint):
    answer, claim, advice = CASES[case]
    assert advice in complaint(DetectorContract, lambda: Fixed(answer), claim)


def test_every_claim_about_detectors_can_fail():
    own = {name for name in vars(DetectorContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
