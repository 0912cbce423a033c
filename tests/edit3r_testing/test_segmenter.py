"""The segmenter's contract finds every way of breaking it."""

from dataclasses import replace

import pytest
import torch

from edit3r.contract.interfaces import Proposal, Segmenter
from edit3r_testing import SegmenterContract


class Spoiled(Segmenter):
    """A good segmenter with some of its methods' answers changed."""

    def __init__(self, good, masks=None, words=None, track=None):
        same = lambda answer: answer  # noqa: E731
        self.good = good
        self.changes = (masks or same, words or same, track or same)

    def masks(self, image, clicks, box=None, before=None):
        if image.std() == 0 and self.changes[0] is fail_when_dull:
            raise ValueError("nothing stands out")
        return self.changes[0](self.good.masks(image, clicks, box, before))

    def words(self, image, text):
        return self.changes[1]((Proposal(image.mean(0)),))

    def track(self, images, masks):
        return self.changes[2](self.good.track(images, masks))


def fail_when_dull(answer):
    return answer


def never_lost(tracks):
    return replace(tracks, present=torch.ones_like(tracks.present))


def lost_but_drawn(tracks):
    logits = tracks.logits.clone()
    logits[~tracks.present] = 1
    return replace(tracks, logits=logits)


MARKED = "test_a_click_and_a_box_give_masks"
NAMED = "test_words_give_masks_or_nothing"
CASES = {
    "a quality in percent": (
        {"masks": lambda m: replace(m, quality=torch.full((len(m.logits),), 90.0))},
        MARKED,
        "quality spans [90, 90]",
    ),
    "an error when nothing stands out": (
        {"masks": fail_when_dull},
        "test_a_blank_image_is_no_error",
        "raised ValueError: nothing stands out",
    ),
    "logits for a soft mask": (
        {"words": lambda found: (Proposal(found[0].soft_mask * 8 - 4),)},
        NAMED,
        "soft_mask in [0, 1]",
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


def test_a_segmenter_that_only_answers_marks_keeps_the_contract(examples):
    good = examples.build("segmenter", "worked-segmenter")

    class OnlyMarks(Segmenter):
        def masks(self, image, clicks, box=None, before=None):
            return good.masks(image, clicks, box, before)

    bound = type("Bound", (SegmenterContract,), {"build": lambda self: OnlyMarks()})
    for claim in {claim for _, claim, _ in CASES.values()}:
        getattr(bound(), claim)()
