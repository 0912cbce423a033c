"""A segmenter that breaks its contract is named, whatever it was asked."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_select.held import HeldSegmenter

from edit3r.contract.component import component_name
from edit3r.contract.errors import PluginError
from edit3r.contract.interfaces import Marks, Segmenter, Tracks, as_proposal

IMAGES = torch.rand(2, 3, 8, 12)
MASK = torch.eye(8, 12)
GOOD = as_proposal(MASK)
FOLLOWED = Tracks(torch.ones(2, 1, 8, 12), torch.ones(2, 1, dtype=torch.bool))


class Answers(Segmenter):
    """Answers one thing, whatever it is asked; an error is raised."""

    def __init__(self, answer):
        self.answer = answer

    def propose(self, image):
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer

    def segment_marks(self, image, marks):
        return self.propose(image)

    def readings(self, image, marks):
        return self.propose(image)

    def ask(self, image, clicks, box=None, before=None):
        return self.propose(image)

    def segment_text(self, image, text):
        return self.propose(image)

    def track(self, images, masks):
        return self.propose(images)


class Spoils(Answers):
    def propose(self, image):
        image.numpy()[:] = 0
        return self.answer


ASKED = {
    "propose": lambda held: held.propose(IMAGES[0]),
    "marks": lambda held: held.segment_marks(IMAGES[0], Marks(((0.5, 0.5),))),
    "readings": lambda held: held.readings(IMAGES[0], Marks(((0.5, 0.5),))),
    "text": lambda held: held.segment_text(IMAGES[0], "box"),
    "ask": lambda held: held.ask(IMAGES[0], [((0.5, 0.5), True)]),
    "track": lambda held: held.track(IMAGES, MASK[None]),
}


def mask(value):
    return replace(GOOD, soft_mask=value)


@pytest.mark.parametrize(
    "asked, answer, said",
    [
        *((asked, ValueError("no"), "raised ValueError: no") for asked in ASKED),
        (
            "propose",
            None,
            "must return a tuple of edit3r.contract.interfaces.Proposal, got NoneType",
        ),
        ("readings", (), "must read marks as something"),
        (
            "readings",
            (MASK,),
            "must return edit3r.contract.interfaces.Proposal, got Tensor",
        ),
        (
            "text",
            "box",
            "must return a tuple of edit3r.contract.interfaces.Proposal, got str",
        ),
        ("text", (mask(MASK / 0),), "soft_mask with 96 of 96 values not finite"),
        (
            "marks",
            None,
            "must return edit3r.contract.interfaces.Proposal, got NoneType",
        ),
        ("marks", mask(MASK.numpy()), "soft_mask as a tensor, got ndarray"),
        ("marks", mask(MASK[:6]), r"soft_mask of shape \[8, 12\], got \[6, 12\]"),
        ("marks", mask(MASK.double()), "soft_mask in torch.float32, got torch.float64"),
        ("marks", mask(255 * MASK), r"soft_mask in \[0, 1\], got 0 to 255"),
        ("marks", replace(GOOD, confidence=float("nan")), "confidence made of numbers"),
        ("marks", replace(GOOD, box=None), "box made of numbers, got None"),
        ("track", None, "must return edit3r.contract.interfaces.Tracks, got NoneType"),
        (
            "track",
            replace(FOLLOWED, logits=FOLLOWED.logits[:1]),
            r"logits of shape \[2, 1, 8, 12\]",
        ),
        ("ask", np.ones((3, 8, 12)), r"logits \[n, h, w\] and their quality"),
        (
            "ask",
            (np.ones((3, 8, 12)), np.ones(2)),
            r"got shapes \[\[3, 8, 12\], \[2\]\]",
        ),
        ("ask", (np.full((1, 8, 12), np.nan), np.ones(1)), "all of them finite"),
        ("track", replace(FOLLOWED, present=torch.ones(2, 1)), "present in torch.bool"),
    ],
)
def test_a_segmenter_that_breaks_its_contract_is_named(asked, answer, said):
    with pytest.raises(PluginError, match=f"^segmenter 'Answers' .*{said}"):
        ASKED[asked](HeldSegmenter(Answers(answer)))


def test_what_it_was_given_stays_as_it_was():
    images = IMAGES.clone()
    with pytest.raises(PluginError, match="must leave its arguments as they are"):
        HeldSegmenter(Spoils(GOOD)).segment_marks(images[0], Marks())


def test_good_answers_and_the_name_pass():
    held = HeldSegmenter(Answers(GOOD))
    assert component_name(held.asked) == "Answers"
    assert held.segment_marks(IMAGES[0], Marks()) is GOOD
    assert HeldSegmenter(Answers([GOOD])).propose(IMAGES[0]) == (GOOD,)
    several = np.ones((3, 4, 6)), np.ones(3)
    assert HeldSegmenter(Answers(several)).ask(IMAGES[0], []) is several
    assert HeldSegmenter(Answers(None)).ask(IMAGES[0], []) is None
    assert HeldSegmenter(Answers(None)).segment_text(IMAGES[0], "box") is None
    assert HeldSegmenter(Answers(FOLLOWED)).track(IMAGES, MASK[None]) is FOLLOWED
