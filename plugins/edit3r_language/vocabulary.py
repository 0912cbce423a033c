"""The words that the reader of instructions knows. What is not here it must not guess."""

from edit3r.contract.instructions import Change, ChangeKind
from edit3r.kit.compute.colour_names import BASIC_COLOURS


def words_of(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


BASIC = frozenset(BASIC_COLOURS)

# ---- adjustments ----

_ADJUSTMENTS: dict[tuple[ChangeKind, float], str] = {
    ("brightness", 1.0): "brighter lighter brighten lighten bright",
    ("brightness", -1.0): "darker dimmer darken dim dark",
    ("warmth", 1.0): "warm warmer",
    ("warmth", -1.0): "cold colder cool cooler",
    (
        "saturation",
        1.0,
    ): "saturated saturate vivid vibrant colourful colorful livelier punchier deeper richer",
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

MORE = words_of("more increase increased raise boost higher stronger")
LESS = words_of("less decrease decreased reduce lower weaker")

TINTS = {
    "redder": "red",
    "greener": "green",
    "bluer": "blue",
    "yellower": "yellow",
    "pinker": "pink",
    "browner": "brown",
}
TINT_SHARE = 0.35

RANDOM = words_of("recolour recoloured random randomly")
"""Words that ask for colours drawn by the seed."""

WEAK = words_of("slightly somewhat bit little tad smidge smidgen trifle fraction")
STRONG = words_of("much very lot far strongly extremely really super way")

# ---- looks ----

LOOKS = words_of(
    "night nighttime midnight moonlight sunset dusk sunrise autumn autumnal fall winter wintry "
    "frost frosty vintage retro noir sketch sketched pencil cartoon comic comics watercolour "
    "aquarelle weathered worn aged"
)
"""Words for a look of the whole that stand without "like"."""

NOT_DRAWN = words_of("snowfall")
"""What a look has in the world and no look here has: its words are left out, and that is said."""

STYLE = words_of("like as style styled")
"""Words before a look."""

# ---- actions ----

REMOVE = words_of("remove delete erase eliminate hide ditch")
OTHER = words_of(
    "undo revert reset add insert put place replace swap move wear wearing hold holding rotate "
    "resize blur sharpen draw give enlarge shrink stylise stylize"
)
"""Verbs of what neither colours nor removing can do; `give` and `draw` only before a new thing."""

ORDINALS = words_of("first second third fourth fifth last")
"""Words that pick by counting, which nobody here does."""

UNSUPPORTED = words_of("patterned striped dotted checked same") | ORDINALS
"""Words for what a plain colour cannot do, and what picks no thing."""

QUESTIONS = words_of("what why how when who where which whose does do did is are was")
"""Words that a question begins with, which asks for no change."""

INSTEAD = {
    "snow": "'make it look like winter' is a look; no snow falls.",
    "undo": "To undo an edit, begin with it, and give --from the folder of its run: 'undo that'.",
    "rusty": "'rust' and 'rusty red' are colours; rust itself is not drawn.",
    "pastel": "A shade needs a colour: pastel pink.",
    "corner": "Say which: the top right corner, the corner at the left.",
    **dict.fromkeys(
        ("everything", "anything", "whatever", "stuff", "things"),
        "Name the things, or mark them by a click or a box.",
    ),
    "half": "Halves are of the picture: the left half.",
    "third": "Thirds are of the picture: the lower third.",
    "quarter": "Quarters are of the picture: the top left quarter.",
}
"""What to say for words that ask for something else than what can be done."""

PAINT = words_of("paint colour dye spray tint coat")
"""Verbs after which only things and colours follow."""

IMPERATIVES = words_of(
    "brighten lighten darken dim saturate desaturate invert cool warm recolour increase decrease "
    "reduce raise boost lower"
)
"""Changes that may stand before what they change: "darken the wall"."""

KEEP = words_of("keep leave preserve retain keeping leaving maintain")
TOUCH = words_of(
    "touch change paint edit alter modify affect colour touching changing altering"
)
"""After a negation: what is not to be done to the thing that follows."""

NEGATIONS = words_of("not no don't never neither nor isn't avoid without")

AS_IT_IS = words_of(
    "as it they is are was were unchanged untouched intact alone same original colour coloured "
    "full be normal natural own still way only just in"
)
"""What may follow the thing that is kept."""

KEPT_ANYWAY = words_of(
    "else other rest shape texture shading structure lighting light details detail objects "
    "original same everything all the of its background surroundings shadows"
)
"""Things of a clause such as "keep everything else" that asking for one thing never changes."""

# ---- things ----

PRONOUNS = words_of("it its them this that these those they")
POSSESSIVES = words_of("its his her their")
OBJECT = words_of("object thing subject foreground main selection")
WHOLE = words_of(
    "everything all whole entire image images photo photos picture pictures scene view views"
)
BACKGROUND = words_of("background surroundings backdrop")
WHATEVER = words_of("everything anything whatever all stuff things")
STANDING = words_of("on from behind under beside near next above below")
"""After a word such as "everything": where things stand that have no name."""

REST = words_of("rest else others")
NOTHING = words_of("nothing anything no none else more other changes change")
STAYS = words_of("stay stays staying remain remains remaining")
ARTICLES = words_of("the a an")
DETERMINERS = (
    ARTICLES
    | words_of("my our your his her their some both all every each any")
    | PRONOUNS
)

PLACES = words_of(
    "left right middle centre center central top bottom upper lower front back nearest closest "
    "farthest leftmost rightmost"
)
SIZES = words_of(
    "big bigger biggest large larger largest small smaller smallest tall tallest"
)
SHARES = words_of("half third thirds quarter quarters")
PICTURE = words_of("image photo photos picture pictures scene view frame")
"""What "the top of the picture" is a place of."""

SCENES = PICTURE | words_of("room house street garden place world")
"""What has a rest that is the background: "the rest of the room"."""

DESCRIBING = words_of(
    "old new dirty clean broken open closed empty full tiny huge high low long short round square "
    "wooden metal plastic concrete glass leather front back inner outer main whole first second "
    "last other next far near parked painted ancient modern double single"
)
"""Everyday words that describe a thing."""

JOINING = words_of(
    "of on from in with near behind under beside wearing at to next above below"
)
"""Words between a thing and the whole, place or mark by which it is known."""

PARTS = words_of(
    "part parts area areas bit bits region regions pixel pixels places spots side sides"
)
"""Nouns for what has a colour: "the red parts of the bike"."""

FILLERS = words_of(
    "a an the to of in into on at with please now make made turn change be become becomes look "
    "looks appear let have get set render tone tones hue i we you want would like should can "
    "could my our your so that up down also just but is are paint painted colours as for from "
    "them these those some kind sort only one ones coloured convert transform look looking style "
    "effect finish by using his her their there full spray dye tint coat coated give "
    "making turning changing needs need must has ought standing sitting lying parked leaning "
    "hanging walking then by made shade shades use cover wrap way completely fully entirely "
    "totally wholly were was will replace swap prefer"
)
"""Words that carry neither change nor thing in the sentences that are read."""

POLITENESS = words_of(
    "please thanks thank you ok okay hello hi hey kindly just thx cheers"
)
OPENINGS = POLITENESS | words_of(
    "could can would will i i'd we want like love to now also so let's lets if then should need "
    "think apply"
)
"""Words that a clause may begin with and that ask for nothing: "could you please"."""

NICE = words_of(
    "nice ugly beautiful lovely rich pretty solid plain simple strong warm cool"
)
"""Words between "a" and a colour that change nothing: "a nice warm yellow"."""

STYLE_NOUNS = words_of(
    "drawing sketch painting style look effect colours tones tone time mood scene picture image "
    "photo photograph print film filter movie atmosphere light book strip in a the"
)
"""Nouns after the word for a look: "a pencil drawing"."""

SPELLINGS = {
    "color": "colour",
    "colors": "colours",
    "colored": "coloured",
    "recolor": "recolour",
    "recolored": "recoloured",
    "gray": "grey",
    "grayish": "greyish",
    "watercolor": "watercolour",
    "center": "centre",
    "rear": "back",
    "blacken": "black",
    "whiten": "white",
    "watercolours": "watercolour",
    "watercolors": "watercolour",
    "repaint": "paint",
    "teh": "the",
    "plz": "please",
    "pls": "please",
}
"""Words that mean another one."""

_IN_COLOUR = r"(?:in (?:full )?colou?r|colou?red|colou?rful)\b"

_TOO = {
    "dark|dim|gloomy": "brighter",
    "bright|light|pale": "darker",
    "warm": "colder",
    "cold|cool": "warmer",
    "dull|faded|muted|grey": "more saturated",
    "saturated|colou?rful|vivid|vibrant|bright and colou?rful": "less saturated",
    "flat": "more contrast",
}
"""What is wanted where something is "too dark"."""

_CHANGES = "paint|make|turn|colour|color|darken|brighten|lighten|remove|change"
_SHARES_OF_WHAT_IS = (
    ("", "half a stop", 15),
    ("", "two (?:full )?stops", 60),
    ("(?:a |one )", "(?:full )?stop", 30),
    ("", "two thirds", 67),
    ("", "three quarters", 75),
    ("", "half", 50),
    ("(?:a |one )", "third", 33),
    ("(?:a |one )", "quarter", 25),
    ("(?:a |one )", "fifth", 20),
    ("(?:a |one )", "tenth", 10),
)
"""How much darker "a third darker" and "darken by a third" are [percent], and the article. A stop
doubles the light, which makes a picture's values 2^(1/2.2) = 37% more, or 27% less."""

_NO_SIDE = "".join(
    rf"(?<!\b{side} )" for side in ("left", "right", "top", "bottom", "upper", "lower")
)
"""Not after a side: the left half is a place of the picture."""

_WAYS = "bright|dark|warm|cold|saturated|colou?rful|vivid|contrasty"

PHRASES = (
    (r"(?<!\S)\d{1,2}[.)] +(?=[a-z])", ", "),  # a list of instructions
    *(
        (rf"\b(?:much |far |way )?too (?:{words})\b(?! and)", f" {wanted} ")
        for words, wanted in _TOO.items()
    ),
    (r"\b(?:at |a |in )*(?:the )?golden hour\b", " like sunset "),
    (r"\b(?:at |a |in )*(?:the )?blue hour\b", " like dusk "),
    (r"\b(?:pillar|post|letter)[ -]?box red\b", " fire engine red "),
    (r"\b(?:could|can) do with(?: being| a)?\b", " be "),
    (r"\b(?:lose|clean up|wipe away) (?=the\b|all\b|those\b)", " remove "),
    (r"\b(black|whit)en (?=the\b|its\b|my\b)([^,.;]+)", r" paint \2 \1en "),
    (r"\bgr[ea]y out ([^,.;]+)", r" \1 greyscale "),
    (r"\bthan (?:it|they) (?:is|are)(?: now| already)?\b", " "),
    (r"\b(?:give me|give us|let's go for|go for|let's have) an? ", " turned "),
    (
        r"\b(?:let|make) it snow(?: now| everywhere| here)?\W*$",
        " look like winter snowfall ",
    ),
    (r"\bhalve the (?=contrast\b|saturation\b|brightness\b)", " much less "),
    (rf"^\W*first(?:ly)?,? (?={_CHANGES})", " "),
    (r"\b(\d+) ?(?:%|percent\b|per cent\b)", r" \1% "),
    (rf"\btwice as ({_WAYS})\b", r" much more \1 "),
    (rf"\bhalf as ({_WAYS})\b", r" much less \1 "),
    (
        r"\b(?:remove|take|delete) (?:all |the )*colou?rs? (?:from|off|out of|in|of) "
        r"([^,.;]+)",
        r" \1 greyscale ",
    ),
    (r"\b(warm|cold|cool|bright|dim|dark)er light(?:ing)?\b", r" \1er "),
    (r"\b(?:turn )?(?:from )?day (?:in)?to night\b", " look like night "),
    (r"\bhigh(?:er)? (?=contrast\b|saturation\b)", " more "),
    (r"\blow(?:er)? (?=contrast\b|saturation\b)", " less "),
    (r"\bdouble the (?=contrast\b|saturation\b|brightness\b)", " much more "),
    (r"\blooks? better (?=in\b)", " be "),
    (
        r"\b(upper|lower|top|bottom|left|right|front|back) (?:part|end|side) of "
        r"(?!(?:the |this |my )?(?:picture|photo|image|scene|view|frame))",
        r" \1 of ",
    ),
    (r"\bnext to\b", " beside "),
    (r"\b(left|right|top|bottom)[ -]most\b", r" \1most "),
    (r"(?<=\w) (?:and |but )?not (?=(?:the|its|their|my)\b)", ", not "),
    (r"^\W*(no|without) (?:more|any) ", r" \1 "),
    (
        r"\bblack[\s-]*(?:and|&|n)[\s-]*white\b|\bb\s*&\s*w\b|\bgr[ea]y[\s-]+scale\b",
        " greyscale ",
    ),
    (r"\b(?:do|does|did|should|must|may)(?:n't| not)\b|\bdon't\b|\bdont\b", " don't "),
    (r"\btake (.+?) off (the|a|an|my|this|that)\b", r" remove \1 from \2 "),
    (r"\bget rid of\b|\btake (?:away|out|off)\b|\bcut out\b", " remove "),
    (r"\btake (.+?) (?:away|out|off)\b", r" remove \1 "),
    (r"\b(?:make|let) (.+?) (?:disappear|vanish|go away|invisible)\b", r" remove \1 "),
    (r"\bcut (.+?) out\b", r" remove \1 "),
    (r"\b(?:only|just) (.+?) (?:stays?|remains?)\b", r" \1 stays "),
    (r"\b(?:turn|bring|dial|tone) down\b", " decrease "),
    (r"\b(?:turn|bring|dial|crank) up\b", " increase "),
    (r"\beverybody\b|\beveryone\b", " all people "),
    (r"\buse ([^,.;]+?) (?:for|on) ([^,.;]+)", r" paint \2 \1 "),
    (
        r"\b(?:keep|leave) (?:only|just) (.+?) " + _IN_COLOUR + r"|"
        r"\b(?:only|just) (?:keep|leave) (.+?) " + _IN_COLOUR + r"|"
        r"\bonly (.+?) in colou?r\b",
        r" everything except \1\2\3 greyscale ",
    ),
    (
        r"(?<=greyscale )\W*(?:and )?(?:make |turn )?(?:everything else|all else|the rest|"
        r"the others?) (?:is |to |into |in )?(?:greyscale|gr[ea]y)\b",
        " ",
    ),
    (
        r"\b(darker|lighter|deeper|paler|brighter|dark|light) (?:shade|tone|hue) of\b",
        r" \1 ",
    ),
    (
        r"\blook(?:s|ing)? (?:very |really |more )?(?:old|used|ancient)\b",
        " look weathered ",
    ),
    (
        r"\bweathered(?:,| and|,? and) (?:old|weathered|worn|aged|used|rusty)\b",
        " weathered ",
    ),
    (
        r"\b(?:what|(?:the|this|that) (?:thing|object|part|place|spot)(?: that| which)?) "
        r"(?:i|is|was) (?:have |had |just )?(?:clicked|marked|selected|pointed)(?: on| at)?\b",
        " selection ",
    ),
    (
        r"\b(?:is it possible to|would you mind|it would be nice if|would be nice if|what if)\b",
        " please ",
    ),
    (r"\b(?:what|how) about an?\b", " turned "),
    (r"^\W*(?:the |this |my )?(?:picture|photo|image|scene) without\b", " remove "),
    (r"\bplease painting\b", " paint "),
    (r"\b(?:i|we) (?:do not|don't|dont) want to see\b|\baway with\b", " remove "),
    (r"\bget (.+?) out of (?:the|this|my) (?:picture|photo|image)s?\b", r" remove \1 "),
    (r"\bout of (?=\w+\W*$)", " of "),
    (r"\beverything around\b|\ball around\b", " everything except "),
    (r"\bas well as\b", " and "),
    (r"\bas well\b|\btoo\b(?! (?!and\b|but\b|then\b|please\b)[a-z])", " "),
    (r",?\s*\bincluding\b[^,.;]*", " completely "),
    (r"\ball of\b|\ball over\b", " whole "),
    (
        r"\bapart from\b|\bother than\b|\bexcept for\b|\bexcluding\b|\bbesides\b|\bsave for\b",
        " except ",
    ),
    (r",\s*(?=except\b)", " "),
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
    (r"\b(?:furthest|farthest) (?:to|on) (?=the (?:left|right)\b)", " on "),
    (r"\b(?:closest|nearest) to\b", " beside "),
    (r"^\W*(?:show me|imagine|picture) (?=the\b|this\b|it\b|my\b)", " "),
    (r"\b(?:in)?to something (?=\w+er\b)", " "),
    (r"\bcandy[ -]?apple red\b", " fire engine red "),
    *(
        (
            rf"\bby (?:a |one )?{share}\b|{_NO_SIDE}\b{article}{share} "
            rf"(?=(?:{_WAYS}|light|cool|pale|deep)e?r\b|more\b|less\b)",
            f" {percent}% ",
        )
        for article, share, percent in _SHARES_OF_WHAT_IS
    ),
    (
        r"\b(everything|anything|whatever|all|stuff|things) (?:that |which )?"
        r"(?:is|are|stands?|lies?|lying|standing) (?=on\b|behind\b|under\b|near\b)",
        r" \1 ",
    ),
    (
        r"\b(?:two|three|some|several|a few|a couple of) (?=(?:shades|tones) \w+er\b)",
        " ",
    ),
    (r"\b(?:i|we)(?: would|'d)? (?:want|like|love|need) an? ", " turned "),
    (r"\bswitch\b", " change "),
    (r"\bnothing (?:but|except)\b", " "),
    (
        r"(?<=\w )(?:anything|whatever|what) (?:is|are|looks)\b",
        " everything thatis ",
    ),
    (r"\banything (?=(?:that|which) (?:is|are)\b)", " everything "),
    (r"\b(?:that|which) (?:is|are)\b", " thatis "),
    (r"\binstead of\b|\brather than\b", " insteadof "),
    (r"\ba (?:bit|little|touch)\b", " slightly "),
    (r"\bjust the\b|\bonly the\b", " the "),
    (r"\bin front\b", " front "),
    (r"\bin (?:the )?style of\b", " like "),
)
"""Regular expressions and what is read in their place, in order."""
