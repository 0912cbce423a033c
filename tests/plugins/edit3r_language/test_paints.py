"""Words about light go with the paint, or are named."""

import pytest
from edit3r_language.paints import read_paint


@pytest.mark.parametrize(
    ("words", "said", "left_out"),
    [
        ("matte black", "matte black", ()),
        ("black matte", "matte black", ()),
        ("light metallic grey", "metallic light grey", ()),
        ("shiny red car", "red", ("shiny",)),
        ("gold", "gold", ()),
        ("white marble", "white marble", ()),
    ],
)
def test_words_about_light_go_with_the_paint(words, said, left_out):
    paint = read_paint(words.split())
    assert (str(paint.change), paint.left_out) == (said, left_out)


def test_a_word_about_light_alone_is_no_paint():
    assert read_paint(["shiny", "car"]) is None
