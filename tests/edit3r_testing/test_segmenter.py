"""The segmenter's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Segmenter
from edit3r_testing import SegmenterContract


class Spoiled(Segmenter):
    """A good segmenter with some of its methods' answers changed."""

    def __init__(self, good, propose=None, segment=None, track=None):
        same = lambda answer: answer  # noqa: E731
        self.good, self.changes = (
            good,
            (propose or same, segment or same, track or same),
        )

    def propose(self, image):
        return self.changes[0](self.good.propose(image))

    def segment(self, image, points=(), box=None):
        return self.changes[1](self.good.segment(image, points, box))

    def track(self, images, masks):
        return self.changes[2](self.good.track(images, masks))


def fail_when_dull(proposals):
    if proposals[0].area > 0.99:
        raise ValueError("nothing stands out")
    return proposals


def first(**changes):
    return {
        "propose": lambda proposals: (replace(proposals[0], **changes), *proposals[1:])
    }


def never_lost(tracks):
    return replace(tracks, present=torch.ones_like(tracks.present))


def lost_but_drawn(tracks):
    logits = tracks.logits.clone()
    logits[~tracks.present] = 1
    return replace(tracks, logits=logits)


CASES = {
    "a list": (
        {"propose": list},
        "test_proposals_are_in_range",
        "return tuple",
    ),
    "a dictionary": (
        {"propose": lambda p: (vars(p[0]),)},
        "test_proposals_are_in_range",
        "return Proposal",
    ),
    "logits for a soft mask": (
        {
            "propose": lambda p: (
                replace(p[0], soft_mask=p[0].soft_mask * 8 - 4),
                *p[1:],
            )
        },
        "test_proposals_are_in_range",
        "return probabilities, not logits",
    ),
    "stability beyond 1": (
        first(stability=1.5),
        "test_proposals_are_in_range",
        "stability spans [1.5, 1.5]",
    ),
    "area in pixels": (
        first(area=900.0),
        "test_proposals_are_in_range",
        "it is a share",
    ),
    "area of something else": (
        {"propose": lambda p: (replace(p[0], area=(p[0].area + 0.5) % 1), *p[1:])},
        "test_proposals_are_in_range",
        "soft_mask > 0.5 covers",
    ),
    "a box of corners": (
        first(box=(80.0, 60.0, 96.0, 72.0)),
        "test_proposals_are_in_range",
        "(x, y, w, h) in pixels",
    ),
    "an error when nothing stands out": (
        {"propose": fail_when_dull},
        "test_a_blank_image_is_no_error",
        "must handle this input",
    ),
    "no proposal at a point": (
        {"segment": lambda proposal: None},
        "test_a_point_and_a_box_give_one_object",
        "return Proposal",
    ),
    "objects swapped": (
        {"track": lambda tracks: replace(tracks, logits=tracks.logits.flip(1))},
        "test_object_numbers_persist",
        "keep the order of the masks",
    ),
    "presence as numbers": (
        {"track": lambda tracks: replace(tracks, present=tracks.present.float())},
        "test_tracks_have_the_promised_shape",
        "torch.bool",
    ),
    "never lost": (
        {"track": never_lost},
        "test_lost_objects_are_reported",
        "objects are present on a black image",
    ),
    "lost but drawn": (
        {"track": lost_but_drawn},
        "test_lost_objects_are_reported",
        "a lost object has logits above 0",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_segmenter_broken_by(case, examples, complaint):
    changes, claim, advice = CASES[case]
    good = examples.build("segmenter", "worked-segmenter")
    assert advice in complaint(
        SegmenterContract, lambda: Spoiled(good, **changes), claim
    )


def test_every_claim_about_segmenters_can_fail():
    own = {name for name in vars(SegmenterContract) if name.startswith("test_")}
    assert own == {claim for _, claim, _ in CASES.values()}
