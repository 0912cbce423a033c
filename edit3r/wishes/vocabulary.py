"""The words that the reader of wishes knows. What is not here it must not guess."""

import colorsys

from PIL import ImageColor

from edit3r.contract.wishes import Change, ChangeKind, Colour


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# ---- colours ----

BASIC_COLOURS = [
    "red",
    "orange",
    "yellow",
    "green",
    "blue",
    "purple",
    "pink",
    "brown",
    "black",
    "white",
    "grey",
    "turquoise",
    "cyan",
    "magenta",
    "gold",
    "silver",
    "beige",
    "navy",
    "teal",
    "olive",
    "maroon",
    "violet",
]
"""The colours that messages suggest; every CSS name is understood."""

_EVERYDAY_COLOURS = {
    "bronze": "#cd7f32",
    "burgundy": "#800020",
    "charcoal": "#36454f",
    "chrome": "#c4cad2",
    "copper": "#b87333",
    "cream": "#fffdd0",
    "emerald": "#50c878",
    "golden": "#ffd700",
    "lilac": "#c8a2c8",
    "marble": "#ece9e2",
    "mint": "#98ff98",
    "mustard": "#e1ad01",
    "navyblue": "#000080",
    "babyblue": "#a0cfec",
    "ochre": "#cc7722",
    "rose": "#ff007f",
    "ruby": "#9b111e",
    "scarlet": "#ff2400",
    "silvery": "#c0c0c0",
    "steel": "#9aa3ad",
    "terracotta": "#e2725b",
    "wood": "#8a5a2b",
    # As a painter would mix them: CSS's pure primaries are lamps, its green is very dark, and its
    # brown is a red.
    "brown": "#7a4a26",
    "red": "#dc1414",
    "green": "#1e9632",
    "blue": "#1e50dc",
    "yellow": "#ffdc00",
}
TONES = {
    "light": 0.45,
    "lighter": 0.45,
    "pale": 0.6,
    "pastel": 0.55,
    "bright": 0.12,
    "dark": -0.4,
    "darker": -0.4,
    "deep": -0.25,
}
"""Share of the way to white, or (negative) to black."""

MATERIALS = {
    "gold": "gold",
    "golden": "gold",
    "gilded": "gold",
    "silver": "silver",
    "silvery": "silver",
    "bronze": "bronze",
    "copper": "copper",
    "chrome": "chrome",
    "steel": "steel",
    "marble": "marble",
    "wood": "wood",
    "wooden": "wood",
    "snow": "snow",
}
"""Words for what a thing may look as if it were made of."""

_MATERIAL_COLOURS = {"gilded": "gold", "wooden": "wood"}


def read_colour(words: list[str]) -> tuple[Colour, int] | None:
    """The colour at the start of `words`, and how many words it takes.

    The longest reading wins: "light sea green" is one colour.
    """
    for length in (3, 2, 1):
        rgb = _toned(words[:length]) if len(words) >= length else None
        if rgb is not None:
            return Colour(" ".join(words[:length]), rgb), length
    return None


def _toned(words: list[str]) -> tuple[float, float, float] | None:
    """sRGB of a colour's name, which may begin with "light", "dark" and the like."""
    rgb = _named("".join(words))
    if rgb is not None or len(words) == 1 or words[0] not in TONES:
        return rgb
    rgb = _named("".join(words[1:]))
    if rgb is None:
        return None
    tone = TONES[words[0]]
    hue, lightness, saturation = colorsys.rgb_to_hls(*rgb)
    lightness *= 1 + min(tone, 0)
    lightness += max(tone, 0) * (1 - lightness)
    return colorsys.hls_to_rgb(hue, lightness, saturation)


def _named(name: str) -> tuple[float, float, float] | None:
    given = _EVERYDAY_COLOURS.get(name)
    if given is None and (name in ImageColor.colormap or name.startswith("#")):
        given = name
    if given is None or name == "snow":  # CSS has it; here it is a material
        return None
    try:
        red, green, blue = ImageColor.getrgb(given)[:3]
    except ValueError:  # "#" and letters that are no colour
        return None
    return red / 255, green / 255, blue / 255


def read_paint(words: list[str]) -> tuple[Change, int] | None:
    """The paint at the start of `words`: a material or a colour."""
    if words and words[0] in MATERIALS:
        name = MATERIALS[words[0]]
        rgb = _named(name) or (0.96, 0.97, 1.0)  # snow
        return Change("paint", Colour(words[0], rgb), material=name), 1
    found = read_colour(words)
    if found is None:
        return None
    colour, length = found
    if words[length : length + 1] and words[length] in MATERIALS:  # "white marble"
        name = f"{colour.name} {words[length]}"
        material = MATERIALS[words[length]]
        return Change("paint", Colour(name, colour.rgb), material=material), length + 1
    return Change("paint", colour), length


# ---- adjustments ----

_ADJUSTMENTS: dict[tuple[ChangeKind, float], str] = {
    ("brightness", 1.0): "brighter lighter brighten lighten bright",
    ("brightness", -1.0): "darker dimmer darken dim dark",
    ("warmth", 1.0): "warm warmer",
    ("warmth", -1.0): "cold colder cool cooler",
    (
        "saturation",
        1.0,
    ): "saturated saturate vivid vibrant colourful colorful livelier punchier",
    ("saturation", -1.0): "desaturated desaturate muted faded dull duller unsaturated",
    ("contrast", 1.0): "contrasty crisper",
    ("contrast", -1.0): "flat flatter",
    ("greyscale", 1.0): "greyscale grayscale monochrome colourless colorless",
    ("sepia", 1.0): "sepia",
    ("invert", 1.0): "invert inverted",
}
ADJUSTMENTS = {
    word: Change(kind, amount=amount)
    for (kind, amount), words in _ADJUSTMENTS.items()
    for word in words.split()
}
"""Words that say one adjustment each."""

PROPERTIES: dict[str, ChangeKind] = {
    **dict.fromkeys(("brightness", "exposure", "light"), "brightness"),
    "contrast": "contrast",
    **dict.fromkeys(("saturation", "colour", "colours", "vibrance"), "saturation"),
    "warmth": "warmth",
}
"""Nouns that "more" and "less" can stand before."""

MORE = _words("more increase increased raise boost higher stronger")
LESS = _words("less decrease decreased reduce lower weaker")

TINTS = {
    "redder": "red",
    "greener": "green",
    "bluer": "blue",
    "yellower": "yellow",
    "pinker": "pink",
    "browner": "brown",
}
TINT_SHARE = 0.35

RANDOM = _words("recolour recoloured random randomly")
"""Words that ask for colours drawn by the seed."""

WEAK = _words("slightly somewhat bit little")
STRONG = _words("much very lot far strongly extremely really super way")

# ---- looks ----

LOOKS = _words(
    "night nighttime midnight moonlight sunset dusk sunrise autumn autumnal fall winter wintry "
    "frost frosty vintage retro noir sketch sketched pencil cartoon comic comics watercolour "
    "aquarelle"
)
"""Words for a look of the whole that stand without "like"."""

STYLE = _words("like as style styled")
"""Words before a look."""

# ---- actions ----

REMOVE = _words("remove delete erase eliminate hide")
OTHER = _words(
    "add insert put place replace swap move wear wearing hold holding rotate resize blur sharpen "
    "draw give enlarge shrink stylise stylize"
)
"""Verbs of what neither colours nor removing can do; `give` and `draw` only before a new thing."""

UNSUPPORTED = _words(
    "metallic matte glossy shiny neon fluorescent patterned striped dotted same"
)
"""Words for what a plain colour cannot do."""

PAINT = _words("paint colour dye spray tint coat")
"""Verbs after which only things and colours follow."""

IMPERATIVES = _words(
    "brighten lighten darken dim saturate desaturate invert cool warm recolour increase decrease "
    "reduce raise boost lower"
)
"""Changes that may stand before what they change: "darken the wall"."""

KEEP = _words("keep leave preserve retain keeping leaving maintain")
TOUCH = _words(
    "touch change paint edit alter modify affect colour touching changing altering"
)
"""After a negation: what is not to be done to the thing that follows."""

NEGATIONS = _words("not no don't never neither nor isn't avoid without")

AS_IT_IS = _words(
    "as it they is are was were unchanged untouched intact alone same original colour coloured "
    "full be normal natural own still way only just in"
)
"""What may follow the thing that is kept."""

KEPT_ANYWAY = _words(
    "else other rest shape texture shading structure lighting light details detail objects "
    "original same everything all the of its background surroundings shadows"
)
"""Things of a clause such as "keep everything else" that a wish about one thing never changes."""

# ---- things ----

PRONOUNS = _words("it its them this that these those they")
OBJECT = _words("object thing subject foreground main selection")
WHOLE = _words(
    "everything all whole entire image images photo photos picture pictures scene view views"
)
BACKGROUND = _words("background surroundings backdrop")
REST = _words("rest else others")
NOTHING = _words("nothing anything no none else more other changes change")
STAYS = _words("stay stays staying remain remains remaining")
DETERMINERS = (
    _words("the a an my our your his her their some both every each any") | PRONOUNS
)

PLACES = _words(
    "left right middle centre center central top bottom upper lower front back nearest closest "
    "farthest leftmost rightmost"
)
SIZES = _words(
    "big bigger biggest large larger largest small smaller smallest tall tallest"
)
EVERY = _words("all both every each two three four five")
PARTS = _words(
    "part parts area areas bit bits region regions pixel pixels places spots side sides"
)
"""Nouns for what has a colour: "the red parts of the bike"."""

FILLERS = _words(
    "a an the to of in into on at with please now make made turn change be become becomes look "
    "looks appear let have get set render tone tones hue i we you want would like should can "
    "could my our your so that up down also just but is are paint painted colours as for from "
    "them these those some kind sort only one ones coloured convert transform look looking style "
    "effect finish by using his her their there full spray dye tint coat coated give "
    "then by made completely fully entirely "
    "totally wholly were was will replace swap"
)
"""Words that carry neither change nor thing in the sentences that are read."""

POLITENESS = _words("please thanks thank you ok okay hello hi kindly just")
OPENINGS = POLITENESS | _words(
    "could can would will i i'd we want like to now also so let's lets what if then should need"
)
"""Words that a clause may begin with and that ask for nothing: "could you please"."""

FLOOD = _words("whole entire completely fully entirely totally wholly")
"""Words that want all of a thing painted, its neutral parts too."""

NICE = _words("nice beautiful lovely rich pretty solid plain simple strong warm cool")
"""Words between "a" and a colour that change nothing: "a nice warm yellow"."""

STYLE_NOUNS = _words(
    "drawing sketch painting style look effect colours tones tone time mood scene picture image "
    "photo photograph print film movie atmosphere light in a the"
)
"""Nouns after the word for a look: "a pencil drawing"."""

SPELLINGS = {
    "color": "colour",
    "colors": "colours",
    "colored": "coloured",
    "recolor": "recolour",
    "recolored": "recoloured",
    "gray": "grey",
    "grayish": "grey",
    "greyish": "grey",
    "reddish": "red",
    "bluish": "blue",
    "greenish": "green",
    "watercolor": "watercolour",
    "center": "centre",
}
"""Words that mean another one."""

PHRASES = (
    (
        r"\bblack[\s-]*(?:and|&|n)[\s-]*white\b|\bb\s*&\s*w\b|\bgr[ea]y[\s-]+scale\b",
        " greyscale ",
    ),
    (r"\b(?:do|does|did|should|must|may)(?:n't| not)\b|\bdon't\b|\bdont\b", " don't "),
    (r"\bget rid of\b|\btake (?:away|out|off)\b|\bcut out\b", " remove "),
    (r"\btake (.+?) (?:away|out|off)\b", r" remove \1 "),
    (r"\b(?:make|let) (.+?) (?:disappear|vanish|go away|invisible)\b", r" remove \1 "),
    (r"\bcut (.+?) out\b", r" remove \1 "),
    (
        r"\b(?:keep|leave) only (.+?) in (?:full )?colou?r\b|\bonly (.+?) in colou?r\b",
        r" everything except \1\2 greyscale ",
    ),
    (r"\beverything around\b|\ball around\b", " everything except "),
    (r"\bas well as\b", " and "),
    (r"\bas well\b|\btoo\b", " "),
    (r",?\s*\bincluding\b[^,.;]*", " completely "),
    (r"\ball of\b|\ball over\b", " whole "),
    (
        r"\bapart from\b|\bother than\b|\bexcept for\b|\bexcluding\b|\bbesides\b|\bsave for\b",
        " except ",
    ),
    (
        r"\bas if (?:it|they) (?:is|are|was|were)(?: all)? made (?:out )?of\b",
        " made of ",
    ),
    (
        r"\blike (?:it|they) (?:is|are|was|were)(?: all)? made (?:out )?of\b",
        " made of ",
    ),
    (
        r"\bas if (?:it|they) (?:is|are|was|were)(?: all)? "
        r"(?:drawn|painted|sketched|done) (?:with|in|by)\b",
        " like ",
    ),
    (r"\b(trash|garbage|rubbish|tin|soda|beer|oil|watering) can\b", r" \1can "),
    (r"\bby half\b", " slightly "),
    (r"\b(?:i|we)(?: would|'d)? (?:want|like|need) an? ", " turned "),
    (r"\bswitch\b", " change "),
    (r"\bnothing (?:but|except)\b", " "),
    (r"\b(?:that|which) (?:is|are)\b", " thatis "),
    (r"\binstead of\b|\brather than\b", " insteadof "),
    (r"\ba (?:bit|little)\b", " slightly "),
    (r"\bjust the\b|\bonly the\b", " the "),
    (r"\bin front\b", " front "),
    (r"\bin (?:the )?style of\b", " like "),
)
"""Regular expressions and what is read in their place, in order."""
