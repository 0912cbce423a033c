import pytest
from edit3r_recolor.vocabulary import BASIC_COLOURS, read_colour


@pytest.mark.parametrize("name", BASIC_COLOURS)
def test_every_suggested_colour_is_known(name):
    assert read_colour([name])[2] == 1


@pytest.mark.parametrize(
    "words, name, rgb",
    [
        (["black"], "black", (0, 0, 0)),
        (["light", "blue"], "light blue", (173, 216, 230)),
        (["light", "sea", "green", "please"], "light sea green", (32, 178, 170)),
        (["#ff8000"], "#ff8000", (255, 128, 0)),
        (["#f80"], "#f80", (255, 136, 0)),
    ],
)
def test_css_names_and_hex(words, name, rgb):
    found, colour, length = read_colour(words)
    assert found == name and length == len(name.split())
    assert colour == pytest.approx([level / 255 for level in rgb])


def test_light_and_dark_go_before_any_colour():
    plain, light, dark = (
        sum(read_colour(words)[1])
        for words in (["teal"], ["light", "teal"], ["dark", "teal"])
    )
    assert dark < plain < light


@pytest.mark.parametrize(
    "words", [[], ["bike"], ["light"], ["light", "bike"], ["#zzz"], ["#12345"]]
)
def test_what_is_no_colour_is_none(words):
    assert read_colour(words) is None
