"""Masks from words."""

import pytest
import torch

from edit3r import Views
from edit3r.contract.interfaces import Proposal, Segmenter, Tracks
from edit3r.errors import InputError
from edit3r.reporting import Report, collecting
from edit3r.selection.from_prompt import masks_from_prompt, things_in_prompt


class Reader(Segmenter):
    """Finds a 4 x 4 square for every word it knows, at the place it knows; tracks it one pixel to
    the right.
    """

    def __init__(self, prompt="", **places):
        self.prompt, self.places, self.lost = prompt, places, ()

    def propose(self, image):
        return ()

    def segment(self, image, points=(), box=None):
        raise NotImplementedError

    def segment_text(self, image, text):
        masks = [
            self._square(image, place)
            for word, place in self.places.items()
            if word in text
        ]
        return tuple(Proposal(mask, 0.1, 1.0, 1.0, (0, 0, 4, 4)) for mask in masks)

    def _square(self, image, place):
        mask = torch.zeros(image.shape[1:])
        mask[place[0] : place[0] + 4, place[1] : place[1] + 4] = 0.9
        return mask

    def track(self, images, masks):
        logits = (
            torch.stack([masks.roll(view, -1) for view in range(len(images))]) - 0.5
        )
        present = torch.ones(logits.shape[:2], dtype=torch.bool)
        for view in self.lost:
            present[view], logits[view] = False, -1
        return Tracks(logits, present)


VIEWS = Views(torch.rand(1, 3, 3, 24, 32), torch.eye(3).expand(1, 3, 3, 3))


@pytest.mark.parametrize(
    ("instruction", "things"),
    [
        ("paint the bike red", "the bike"),
        ("turn the old wooden chair into marble", "the old wooden chair"),
        ("Make his jacket blue", "the jacket"),
        ("remove the car", "the car"),
        ("the dog should wear a hat", "the dog"),
        ("add a dog to the street", ""),
        ("make it look like winter", ""),
        ("turn the whole scene into a painting", ""),
        ("make the background blurry", ""),
        ("", ""),
        ("paint the door green and the wall white", "the door, the wall"),
        ("turn the man and the woman into robots", "the man, the woman"),
        ("paint the bike red and shiny, keep the background", "the bike"),
        ("paint the bike red and make the whole picture darker", ""),
    ],
)
def test_the_things_of_an_instruction(instruction, things):
    assert things_in_prompt(instruction) == (
        tuple(filter(None, things.split(", "))),
        False,
    )


@pytest.mark.parametrize(
    "words",
    ["everything except the bear", "all but the bear", "the rest besides the bear"],
)
def test_what_is_left_alone(words):
    assert things_in_prompt(f"paint {words} red") == (("the bear",), True)


def test_the_named_object_is_masked_and_followed():
    masks = masks_from_prompt("paint the bike red", VIEWS, Reader(bike=(6, 8)))[0]
    assert masks.shape == (3, 24, 32)
    for view in range(3):
        assert (masks[view, 6:10, 8 + view : 12 + view] == 1).all()
        assert (
            masks[view, :4].max() == 0
            and masks[view, :, :4].max() == 0
            and masks[view, :, 20:].max() == 0
        )


def test_the_segmenters_prompt_goes_before_the_instruction():
    report = Report()
    with collecting(report):
        masks = masks_from_prompt(
            "paint the bike red", VIEWS, Reader("the car", bike=(6, 8), car=(15, 20))
        )
    assert masks[0, 0, 16, 21] == 1 and masks[0, 0, 7, 9] == 0
    assert report.notes["edit.confined_to"] == "the car"


def test_all_that_the_words_name_is_in_the_mask():
    masks = masks_from_prompt(
        "x", VIEWS, Reader("the bike. the car.", bike=(2, 2), car=(15, 20))
    )
    assert masks[0, 0, 3, 3] == 1 and masks[0, 0, 16, 21] == 1


def test_two_things_of_one_sentence_are_both_in_the_mask():
    masks = masks_from_prompt(
        "paint the door red and the wall blue",
        VIEWS,
        Reader(door=(2, 2), wall=(15, 20)),
    )
    assert (
        masks[0, 0, 3, 3] == 1 and masks[0, 0, 16, 21] == 1 and masks[0, 0, 3, 21] == 0
    )
    with pytest.raises(InputError, match="'the wall' was not found"):
        masks_from_prompt(
            "paint the door red and the wall blue", VIEWS, Reader(door=(2, 2))
        )


def test_everything_except_a_thing_is_in_the_mask():
    reader, report = Reader(bear=(6, 8)), Report()
    reader.lost = (2,)
    with collecting(report):
        masks = masks_from_prompt("paint everything except the bear red", VIEWS, reader)
    assert (masks[0, 0, 6:10, 8:12] == 0).all() and masks[0, 0, 20, 28] == 1
    assert masks[0, 2].max() == 0  # the bear may be anywhere on it
    assert report.notes["edit.confined_to"] == "all but the bear"


def test_a_view_where_it_is_lost_stays_unedited_and_is_told():
    reader, report = Reader(bike=(6, 8)), Report()
    reader.lost = (2,)
    with collecting(report):
        masks = masks_from_prompt("paint the bike red", VIEWS, reader)
    assert masks[0, 2].max() == 0 and masks[0, 1].max() == 1
    assert "photo 3" in report.warnings[0]


class Mute(Reader):
    def segment_text(self, image, text):
        return None


def test_an_instruction_about_no_one_thing_confines_nothing_and_is_told():
    report = Report()
    with collecting(report):
        assert masks_from_prompt("make it winter", VIEWS, Reader(bike=(6, 8))) is None
    assert "names no one object" in report.warnings[0]


@pytest.mark.parametrize(
    ("segmenter", "says"),
    [
        (Reader(car=(6, 8)), "'the bike' was not found"),
        (Mute(), "'the bike' is not a word"),
    ],
)
def test_what_cannot_be_found_is_an_error_with_the_way_out(segmenter, says):
    with pytest.raises(InputError, match=f"{says}.*--point.*--guess"):
        masks_from_prompt("paint the bike red", VIEWS, segmenter)
