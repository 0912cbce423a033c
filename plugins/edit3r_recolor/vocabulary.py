"""The words the prompt reader knows. Everything it does not find here it must not guess."""

from edit3r_recolor.wish import Adjust


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_DIRECTIONS = {
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
ADJUSTMENTS = {word: Adjust(what, amount) for (what, amount), words in _DIRECTIONS.items() for word in words.split()}
"""One word, one adjustment."""

_PROPERTY_WORDS = {
    "brightness": "brightness exposure light",
    "contrast": "contrast",
    "saturation": "saturation colour color colours colors",
    "warmth": "warmth",
}
PROPERTIES = {word: what for what, words in _PROPERTY_WORDS.items() for word in words.split()}
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

IMPERATIVES = _words("brighten lighten darken dim saturate desaturate invert cool warm recolor recolour")
"""Changes that may stand before what they change: "darken the wall"."""

WEAK = _words("slightly somewhat bit little")
STRONG = _words("much very lot far strongly extremely really super")

PRONOUNS = _words("it its them this that")
OBJECT_WORDS = _words("object thing subject foreground main")
EVERYTHING = _words("everything all whole entire picture pictures image images photo photos scene view views")
BACKGROUND = _words("background rest surroundings else")
DETERMINERS = _words("the my our of every both these those") | PRONOUNS | EVERYTHING

FILLERS = _words(
    "a an the of to in into with please now make turn paint colour color change give be become look appear let have "
    "get set render dye tint shade tone tones hue i we you want would like should can could my our so that up down as "
    "coloured colored painted colours colors at them these those some kind sort also just but is are in made convert "
    "transform"
)
"""Words that carry neither change nor object in the sentences we read."""

UNSUPPORTED = _words(
    "remove delete erase replace swap insert put place move wear wearing hold holding style styled stylize stylise "
    "cartoon painting drawing sketch watercolor watercolour blur sharpen rotate resize"
)
"""Words that ask for what colours alone cannot do."""

NEGATIONS = _words("not no don't dont never without except neither nor isn't instead rather avoid")

POLITENESS = _words("please thanks thank you ok okay")

KEPT_ANYWAY = _words(
    "keep leave everything else the rest of background surroundings picture image scene unchanged same as is it they "
    "are was intact untouched original its shape texture shading structure lighting light details all other objects"
)
"""A clause of only these words ("keep the background unchanged") asks for what a recolouring does in any case."""
