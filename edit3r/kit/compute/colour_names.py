"""Names of colours: what people call colours, and shades of them.

Names come from three lists: everyday words as a painter would mix them, CSS (in Pillow), and the
949 names of the xkcd colour survey. Shades such as "very dark sage green" are computed.
"""

import colorsys
import difflib
import math
import re
from functools import cache
from importlib.resources import files
from typing import Literal

from PIL import ImageColor

from edit3r.contract.instructions import Colour

RGB = tuple[float, float, float]


def _words_of(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _lines(name: str) -> list[str]:
    """The lines of a table beside this file, without comments."""
    text = files("edit3r.kit.compute").joinpath(name).read_text("utf-8")
    return [line for line in text.splitlines() if not line.startswith("# ")]


BASIC_COLOURS = (
    *("red", "orange", "yellow", "green", "blue", "purple", "pink", "brown", "black"),
    *("white", "grey", "turquoise", "cyan", "magenta", "gold", "silver", "beige"),
    *("navy", "teal", "olive", "maroon", "violet"),
)
"""The colours that messages suggest first, and that "more" may stand before."""

TONES = {
    word: (float(tone), float(saturation))
    for tone, saturation, *words in map(str.split, _lines("colour_tones.txt"))
    for word in words
}
"""Shades: the share of the way to white, or (negative) to black, and a factor on saturation."""

COMPARED: dict[str, Literal[-1, 1]] = {
    "lighter": 1,
    "brighter": 1,
    "paler": 1,
    "darker": -1,
    "deeper": -1,
}
"""Shades that are said against what the thing is now, and their direction."""

NEON = ("neon", "fluorescent", "fluoro")
VERY = ("very", "really", "super", "extremely")

_MADE_ON_THE_COLOUR_ITSELF = ("dark", "deep", "light", "bright", "pale")
"""Tones that with a basic colour are computed; dark ones where the survey's is nearly black."""

_NEARLY_BLACK = 0.5  # the largest of red, green and blue

# Names of the lists that here mean another thing: a material, a look, an adjustment, a shade.
_NO_COLOURS = _words_of(
    "snow dark pale midnight dusk twilight sepia bland royal drab brick stone sandstone ice "
    "denim leather velvet grass moss water mud dirt clay cement earth dust straw sky sea ocean "
    "forest leaf desert swamp"
)
_STUFF = _NO_COLOURS - {"snow", "dark", "pale", "sepia", "water"}

MAX_WORDS = 6
# how far a colour may be from the basic one that it is a kind of [RGB]; no figure kept
_A_KIND = 0.45


def read_colour(words: list[str]) -> tuple[Colour, int] | None:
    """The colour at the start of `words`, and how many words it takes.

    The longest reading wins: "light sea green" is one colour.
    """
    for length in range(min(MAX_WORDS, len(words)), 0, -1):
        rgb = _toned(words[:length])
        if rgb is not None:
            return Colour(" ".join(words[:length]), rgb), length
    return None


def read_colour_of(words: list[str]) -> tuple[Colour, int] | None:
    """The colour after "the colour of", where "brick" and "grass" are colours too."""
    colour = read_colour(words)
    if colour is not None or not words or words[0] not in _STUFF:
        return colour
    rgb = _rgb(_listed()[words[0]])
    assert rgb is not None
    return Colour(words[0], rgb), 1


_RUDE = frozenset(
    ["barf", "booger", "piss", "poo", "poop", "puke", "shit", "snot", "vomit"]
)
"""Words in names of the survey that are read, and never proposed."""


def near_colours(word: str, count: int = 3) -> list[str]:
    """Names of colours that are spelt nearly like a word, or contain it; none that is rude."""
    names = [name for name in colour_names() if not _RUDE & set(name.split())]
    basic = difflib.get_close_matches(word, BASIC_COLOURS, n=1, cutoff=0.7)
    near = difflib.get_close_matches(word, names, n=count, cutoff=0.75)
    within = [name for name in names if word in name.split()]
    return list(dict.fromkeys((*basic, *near, *within)))[:count]


@cache
def colour_names() -> tuple[str, ...]:
    """All names of the lists, as they are written."""
    survey = [line[8:] for line in _lines("colour_names.txt")]
    spaced = {_key(name): name for name in (*ImageColor.colormap, *survey)}
    return tuple(dict.fromkeys((*BASIC_COLOURS, *spaced.values())))


def _toned(words: list[str]) -> RGB | None:
    """sRGB of a colour's name, which may begin with "light", "very dark" and the like."""
    computed = (
        len(words) == 2
        and words[0] in _MADE_ON_THE_COLOUR_ITSELF
        and words[1] in BASIC_COLOURS
    )
    name = "".join(words)
    # CSS's dark grey is lighter than its grey, and its dark orange is a lamp.
    computed = computed and (words[0] == "dark" or _css(name) is None)
    rgb = _dark_of_survey(words[0], name) if computed else _named(name)
    if rgb is not None or len(words) == 1:
        return rgb
    if words[0] in NEON:
        return _glowing(_toned(words[1:]))
    if words[0] in VERY and len(words) > 2 and words[1] in TONES:  # half as much again
        return _shaded(_toned(words[1:]), TONES[words[1]][0] / 2, 1.0)
    if words[0] not in TONES:
        return _kind_of_basic(words)
    return _shaded(_toned(words[1:]), *TONES[words[0]])


def _dark_of_survey(tone: str, name: str) -> RGB | None:
    """What people call a dark colour, unless it is nearly black: dark pink is no darkened pink."""
    given = _given("colour_names.txt").get(name)
    rgb = _rgb(given) if given and TONES[tone][0] < 0 else None
    return rgb if rgb and max(rgb) >= _NEARLY_BLACK else None


def _kind_of_basic(words: list[str]) -> RGB | None:
    """The colour of "ruby red": a ruby, which is a kind of red; None for "ruby blue"."""
    if len(words) != 2 or words[1] not in BASIC_COLOURS or words[0] in BASIC_COLOURS:
        return None
    kind, basic = _named(words[0]), _named(words[1])
    near = kind is not None and basic is not None and math.dist(kind, basic) < _A_KIND
    return kind if near else None


def _shaded(rgb: RGB | None, tone: float, saturation: float) -> RGB | None:
    """A colour mixed with white or black, with other saturation."""
    if rgb is None:
        return None
    mixed = [x * (1 - abs(tone)) + max(tone, 0) for x in rgb]
    hue, lightness, chroma = colorsys.rgb_to_hls(*mixed)
    return colorsys.hls_to_rgb(hue, lightness, min(1.0, saturation * chroma))


def _glowing(rgb: RGB | None) -> RGB | None:
    """The purest and brightest colour of a hue; black, white and grey have none."""
    if rgb is None or max(rgb) - min(rgb) < 0.05:
        return None
    hue, _, _ = colorsys.rgb_to_hls(*rgb)
    return colorsys.hls_to_rgb(hue, 0.54, 1.0)


def _named(name: str) -> RGB | None:
    """sRGB of a name without spaces, or of "#ff8800"."""
    if name in _NO_COLOURS:
        return None
    if name.startswith("#"):
        return _rgb(name)
    given = _listed().get(_key(name))
    return None if given is None else _rgb(given)


def _css(name: str) -> str | None:
    given = ImageColor.colormap.get(name)
    return given if given is None or isinstance(given, str) else name


def _rgb(text: str) -> RGB | None:
    try:
        red, green, blue, *alpha = ImageColor.getrgb(text)
    except ValueError:  # "#" and letters that are no colour
        return None
    if alpha not in ([], [255]):  # see-through, which no paint is
        return None
    return red / 255, green / 255, blue / 255


def _key(name: str) -> str:
    return re.sub(r"[^a-z]", "", name)


@cache
def _given(file: str) -> dict[str, str]:
    """Colours of a list by their names without spaces."""
    return {_key(line[8:]): line[:7] for line in _lines(file)}


@cache
def _listed() -> dict[str, str]:
    """Colours of all lists; everyday words before CSS before the survey."""
    css = {name: name for name in ImageColor.colormap}
    return _given("colour_names.txt") | css | _given("everyday_colours.txt")
