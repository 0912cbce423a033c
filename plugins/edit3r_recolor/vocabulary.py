"""The words that the prompt reader knows: colours, changes and fillers. What is not here it must
not guess.
"""

import colorsys
import re

from PIL import ImageColor

from edit3r_recolor.steps import Adjust


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_BASIC_NAMES = """
    red orange yellow green blue purple pink brown black white grey turquoise cyan magenta gold silver beige navy teal
    olive maroon violet
"""
BASIC_COLOURS = tuple(_BASIC_NAMES.split())
"""The colours that messages suggest; every CSS name is understood."""

_EVERYDAY_COLOURS = {
    "bronze": "#cd7f32",
    "burgundy": "#800020",
    "charcoal": "#36454f",
    "copper": "#b87333",
    "cream": "#fffdd0",
    "emerald": "#50c878",
    "golden": "#ffd700",
    "lilac": "#c8a2c8",
    "mint": "#98ff98",
    "mustard": "#e1ad01",
    "navyblue": "#000080",
    "babyblue": "#a0cfec",
    "ochre": "#cc7722",
    "rose": "#ff007f",
    "ruby": "#9b111e",
    "scarlet": "#ff2400",
    "silvery": "#c0c0c0",
    "terracotta": "#e2725b",
    # As a painter would mix them: CSS's pure primaries are lamps, its green is very dark, and its
    # brown is a red.
    "brown": "#7a4a26",
    "red": "#dc1414",
    "green": "#1e9632",
    "blue": "#1e50dc",
    "yellow": "#ffdc00",
}
_TONES = {
    "light": 0.45,
    "pale": 0.6,
    "pastel": 0.55,
    "bright": 0.12,
    "dark": -0.4,
    "deep": -0.25,
}

_ADJUSTMENT_WORDS = {
    ("brightness", 1.0): "brighter lighter brighten lighten bright",
    ("brightness", -1.0): "darker dimmer darken dim dark",
    ("warmth", 1.0): "warm warmer",
    ("warmth", -1.0): "cold colder cool cooler",
    ("saturation", 1.0): "saturated saturate vivid vibrant colourful colorful",
    ("saturation", -1.0): "desaturated desaturate muted faded dull duller unsaturated",
    ("contrast", 1.0): "contrasty crisper",
    ("contrast", -1.0): "flat flatter",
    ("greyscale", 1.0): "greyscale grayscale monochrome colourless colorless",
    ("sepia", 1.0): "sepia",
    ("invert", 1.0): "invert inverted",
}
ADJUSTMENTS = {
    word: Adjust(*step)
    for step, words in _ADJUSTMENT_WORDS.items()
    for word in words.split()
}
"""Words that say one adjustment each."""

PROPERTIES = {
    **dict.fromkeys(("brightness", "exposure", "light"), "brightness"),
    "contrast": "contrast",
    **dict.fromkeys(
        ("saturation", "colour", "color", "colours", "colors"), "saturation"
    ),
    "warmth": "warmth",
}
"""Nouns that "more" and "less" can stand before."""

MORE = _words("more increase increased raise boost higher add stronger")
LESS = _words("less decrease decreased reduce lower weaker")

TINTS = {
    "redder": "red",
    "greener": "green",
    "bluer": "blue",
    "yellower": "yellow",
    "pinker": "pink",
    "browner": "brown",
}

RECOLOUR = _words("recolor recolour recolored recoloured random randomly")
"""Words that ask for a sampled transform."""

IMPERATIVES = _words(
    "brighten lighten darken dim saturate desaturate invert cool warm recolor recolour"
)
"""Changes that may stand before what they change: "darken the wall"."""

PAINTING = _words("paint colour color dye spray")
"""Verbs after which only things can follow."""

WEAK = _words("slightly somewhat bit little")
STRONG = _words("much very lot far strongly extremely really super")

PRONOUNS = _words("it its them this that")
OBJECT_WORDS = _words("object thing subject foreground main")
EVERYTHING = _words(
    "everything all whole entire picture pictures image images photo photos scene view views"
)
BACKGROUND = _words("background rest surroundings else")
DETERMINERS = _words("the my our of every both these those") | PRONOUNS | EVERYTHING

FILLERS = _words(
    "a an the of to in into with please now make turn paint colour color change give be become "
    "look appear let have "
    "get set render dye tint shade tone tones hue i we you want would like should can could my "
    "our so that up down as "
    "coloured colored painted colours colors at them these those some kind sort also just but is "
    "are in made convert "
    "transform spray both"
)
"""Words that carry neither change nor object in the sentences we read."""

UNSUPPORTED = _words(
    "remove delete erase replace swap insert put place move wear wearing hold holding style "
    "styled stylize stylise "
    "cartoon painting drawing sketch watercolor watercolour blur sharpen rotate resize "
    "metallic matte"
)
"""Words that ask for what colours alone cannot do."""

NEGATIONS = _words(
    "not no don't dont never without except neither nor isn't instead rather avoid"
)

_ALL = "|".join((*sorted(EVERYTHING), "rest"))
EXCEPTION = re.compile(
    rf"\b(?:{_ALL})\b(.*?)\b(?:except(?: for)?|apart from|other than|but|besides)\b"
)
"""What stands before the thing that is left as it is; its group may hold more words for everything.
"""

REPLACED = re.compile(r"\breplace(?: the)? (\w+) (?:with|by)\b")
ALL_AROUND = re.compile(rf"\b(?:the )?(?:{_ALL}|background)\b")
KEPT_THING = re.compile(
    r"[,;]?(?: (?:and|but|while))? (?:keep|keeping|leave|leaving) (?:only )?(?:the|this|my|our) (?!rest|background|"
    r"surroundings|original|picture|image)([\w' -]+?) (?:in (?:full )?colou?r|as (?:it|they) (?:is|are)|alone|unchanged"
    r"|untouched|colou?red)[ .!]*$"
)
"""What is to stay as it is, at the end of a sentence: "make all black and white but keep the bear
in colour".
"""

POLITENESS = _words("please thanks thank you ok okay")

KEPT_ANYWAY = _words(
    "keep leave everything else the rest of background surroundings picture image scene "
    "unchanged same as is it they "
    "are was intact untouched original its shape texture shading structure lighting light "
    "details all other objects"
)
"""A clause of only these words ("keep the background unchanged") asks for what a recolouring does
in any case.
"""


def read_colour(words: list[str]) -> tuple[str, tuple[float, float, float], int] | None:
    """Read the colour at the start of `words`: its name, sRGB in [0, 1], and how many words it
    takes; None: none.

    The longest reading wins: "light sea green" is one colour.
    """
    for length in (3, 2, 1):
        rgb = _toned_colour(words[:length]) if len(words) >= length else None
        if rgb is not None:
            return " ".join(words[:length]), rgb, length
    return None


def _toned_colour(words: list[str]) -> tuple[float, float, float] | None:
    """sRGB of a colour's name, which may begin with "light", "dark" and the like."""
    rgb = _named_colour("".join(words))
    if rgb is not None or len(words) == 1 or words[0] not in _TONES:
        return rgb
    rgb, tone = _named_colour("".join(words[1:])), _TONES[words[0]]
    if rgb is None:
        return None
    hue, lightness, saturation = colorsys.rgb_to_hls(*rgb)
    lightness = (
        lightness + tone * (1 - lightness) if tone > 0 else lightness * (1 + tone)
    )
    return colorsys.hls_to_rgb(hue, lightness, saturation)


def _named_colour(name: str) -> tuple[float, float, float] | None:
    given = _EVERYDAY_COLOURS.get(name) or (
        name if name in ImageColor.colormap or name.startswith("#") else None
    )
    if given is None:
        return None
    try:
        return tuple(level / 255 for level in ImageColor.getrgb(given)[:3])
    except ValueError:  # "#" and letters that are no colour
        return None
