"""Names of colours: the longest is read, shades are computed, and things stay things."""

import colorsys
import math

import pytest

from edit3r.kit.compute.colour_names import (
    BASIC_COLOURS,
    colour_names,
    near_colours,
    read_colour,
)


def brightness(name):
    """Relative luminance, by Rec. 709."""
    linear = (((x + 0.055) / 1.055) ** 2.4 for x in read_colour(name.split())[0].rgb)
    return sum(x * weight for x, weight in zip(linear, (0.2126, 0.7152, 0.0722)))


def test_the_survey_and_css_are_known():
    names = colour_names()
    assert len(names) > 950
    unknown = [name for name in names if read_colour(name.split()) is None]
    alone = [
        "snow",
        "dark",
        "pale",
        "midnight",
        "dusk",
        "sepia",
        "twilight",
        "bland",
        "sky",
        "sea",
    ]
    assert set(alone) <= set(unknown)  # here they mean something else
    assert len(unknown) < 45


@pytest.mark.parametrize(
    ("words", "length"),
    [
        ("sage green wall", 2),
        ("light sea green", 3),
        ("very dark sage green", 4),
        ("robin's egg blue", 3),
        ("blue with a hint of purple", 6),
        ("neon orange", 2),
        ("#0f0", 1),
    ],
)
def test_the_longest_name_is_read(words, length):
    assert read_colour(words.split())[1] == length


@pytest.mark.parametrize(
    "words",
    ["zorbic green", "the green", "snow", "grass", "dark", "#ff000080", "#f008"],
)
def test_what_is_no_colour_is_none(words):
    assert read_colour(words.split()) is None


@pytest.mark.parametrize(
    ("darker", "lighter"),
    [
        ("dark sage green", "sage green"),
        ("very dark teal", "dark teal"),
        ("teal", "pale teal"),
        ("deep purple", "purple"),
    ],
)
def test_shades_are_darker_or_lighter(darker, lighter):
    light = [
        colorsys.rgb_to_hls(*read_colour(name.split())[0].rgb)[1]
        for name in (darker, lighter)
    ]
    assert light[0] < light[1]


def test_neon_is_pure_and_muted_is_not():
    def saturation(name: str) -> float:
        return colorsys.rgb_to_hls(*read_colour(name.split())[0].rgb)[2]

    assert saturation("neon orange") == pytest.approx(1)
    assert saturation("muted teal") < 0.6 * saturation("teal")


def test_words_that_are_spelt_nearly_like_a_colour_are_offered_the_plain_one_first():
    assert near_colours("purpel")[0] == "purple"
    assert near_colours("turqoise")[0] == "turquoise"
    assert near_colours("qqq") == []


def test_rude_names_of_the_survey_are_read_and_never_proposed():
    assert read_colour(["poop"]) is not None
    assert near_colours("poop") == []


@pytest.mark.parametrize("name", sorted(set(BASIC_COLOURS) - {"black"}))
def test_every_dark_colour_is_darker_than_the_colour_itself(name):
    """CSS's dark grey is lighter than its grey, and its dark orange as bright as a lamp."""
    dark, plain = (brightness(words) for words in (f"dark {name}", name))
    assert dark < 0.75 * plain


@pytest.mark.parametrize(
    ("shade", "like", "unlike"),
    [
        ("dark pink", "#cb416b", "crimson"),
        ("dark yellow", "#d5b60a", "olive"),
        ("light purple", "lilac", "magenta"),
        ("light teal", "pale turquoise", "cyan"),
        ("dark cream", "khaki", "yellow"),
    ],
)
def test_a_shade_stays_of_its_hue(shade, like, unlike):
    colours = (read_colour(name.split())[0].rgb for name in (shade, like, unlike))
    shade, like, unlike = colours
    assert math.dist(shade, like) < math.dist(shade, unlike)
