"""Places of the picture are boxes of it; shares of a thing are not."""

import pytest
from edit3r_language.places import read_region, unclear_place


@pytest.mark.parametrize(
    ("words", "box"),
    [
        ("the left half", (0, 0, 0.5, 1)),
        ("the right half of the picture", (0.5, 0, 0.5, 1)),
        ("the lower third", (0, 2 / 3, 1, 1 / 3)),
        ("the upper two thirds", (0, 0, 1, 2 / 3)),
        ("the top left quarter", (0, 0, 0.5, 0.5)),
        ("the left quarter", (0, 0, 0.25, 1)),
        ("the bottom right corner", (2 / 3, 2 / 3, 1 / 3, 1 / 3)),
        ("the top of the image", (0, 0, 1, 1 / 3)),
        ("the left side", (0, 0, 0.5, 1)),
        ("the middle of the photo", (0.25, 0.25, 0.5, 0.5)),
    ],
)
def test_a_place_is_a_box_of_the_picture(words, box):
    region = read_region(words.split())
    assert region.box == pytest.approx(box)
    assert str(region).endswith("of the picture")


@pytest.mark.parametrize(
    "words",
    [
        "the left",
        "the left cup",
        "the left half of the table",
        "the corner",
        "the top",
        "",
    ],
)
def test_other_words_are_no_place_of_the_picture(words):
    assert read_region(words.split()) is None


@pytest.mark.parametrize(
    ("words", "unclear"),
    [
        ("the left half of the table", ("half",)),
        ("half of the wall", ("half",)),
        ("the middle third", ("third",)),
        ("the corner table", ()),
        ("the left half", ()),
        ("the wall", ()),
    ],
)
def test_a_place_that_no_box_is_names_its_word(words, unclear):
    assert unclear_place(words.split()) == unclear
