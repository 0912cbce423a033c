"""The words that the reader of instructions knows. What is not here it must not guess.

Sets of words stand in `vocabulary.txt`, set phrases in `phrases.txt`.
"""

import re
from dataclasses import dataclass
from importlib.resources import files

from edit3r.contract.instructions import Change, ChangeKind


def words_of(text: str) -> frozenset[str]:
    """The words of a text."""
    return frozenset(text.split())


def pairs_of(text: str) -> dict[str, str]:
    """What each word of `word=other` stands for."""
    return dict(pair.split("=") for pair in text.split())


def _lines(name: str) -> list[str]:
    """The lines of a table beside this file, without comments."""
    text = files("edit3r_language").joinpath(name).read_text("utf-8")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


@dataclass(frozen=True)
class WordSets:
    """Words by what they do in a sentence, as `vocabulary.txt` lists them."""

    more: frozenset[str]
    less: frozenset[str]
    random: frozenset[str]
    weak: frozenset[str]
    strong: frozenset[str]
    looks: frozenset[str]
    not_drawn: frozenset[str]
    style: frozenset[str]
    remove: frozenset[str]
    hide: frozenset[str]
    other: frozenset[str]
    ordinals: frozenset[str]
    unsupported: frozenset[str]
    questions: frozenset[str]
    paint: frozenset[str]
    imperatives: frozenset[str]
    keep: frozenset[str]
    touch: frozenset[str]
    negations: frozenset[str]
    as_it_is: frozenset[str]
    kept_anyway: frozenset[str]
    pronouns: frozenset[str]
    possessives: frozenset[str]
    object: frozenset[str]
    whole: frozenset[str]
    background: frozenset[str]
    whatever: frozenset[str]
    standing: frozenset[str]
    rest: frozenset[str]
    nothing: frozenset[str]
    stays: frozenset[str]
    articles: frozenset[str]
    determiners: frozenset[str]
    places: frozenset[str]
    sizes: frozenset[str]
    shares: frozenset[str]
    picture: frozenset[str]
    scenes: frozenset[str]
    describing: frozenset[str]
    joining: frozenset[str]
    parts: frozenset[str]
    fillers: frozenset[str]
    politeness: frozenset[str]
    openings: frozenset[str]
    nice: frozenset[str]
    style_nouns: frozenset[str]
    known: frozenset[str]

    @classmethod
    def read(cls) -> "WordSets":
        """Those of the file, in which a set may take up those before it. Raises ValueError for a
        set that stands there twice, TypeError for one of another name.
        """
        sets: dict[str, frozenset[str]] = {}
        for line in (
            "\n".join(_lines("vocabulary.txt")).replace("\n  ", " ").splitlines()
        ):
            name, _, listed = line.partition(":")
            if name in sets:
                raise ValueError(f"vocabulary.txt: the set {name!r} stands there twice")
            words = listed.split()
            others = [sets[word[1:]] for word in words if word.startswith("+")]
            own = frozenset(word for word in words if not word.startswith("+"))
            sets[name] = own.union(*others)
        return cls(**sets)


def _phrases() -> list[tuple[re.Pattern[str], str]]:
    """Patterns and what is read in their place, in order."""
    parts: dict[str, str] = {}
    found = []

    def filled(pattern: str) -> str:
        return re.sub(r"<([A-Z_]+)>", lambda part: parts[part[1]], pattern)

    for line in _lines("phrases.txt"):
        pattern, arrow, words = line.partition(" =>")
        if arrow:
            instead = f" {words.strip()} ".replace(" ,", ",")
            found.append((re.compile(filled(pattern)), instead))
        else:
            name, _, part = line.partition(" = ")
            parts[name] = filled(part)
    return found


WORDS = WordSets.read()
PHRASES = _phrases()

_ADJUSTMENTS: dict[tuple[ChangeKind, float], str] = {
    ("brightness", 1.0): "brighter lighter brighten lighten bright",
    ("brightness", -1.0): "darker dimmer darken dim dark",
    ("warmth", 1.0): "warm warmer",
    ("warmth", -1.0): "cold colder cool cooler",
    ("saturation", 1.0): "saturated saturate vivid vibrant colourful colorful livelier "
    "punchier deeper richer",
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

TINTS = pairs_of(
    "redder=red greener=green bluer=blue yellower=yellow pinker=pink browner=brown"
)
"""Comparatives that tint, and the colour that each leans to."""

INSTEAD = {
    "snow": "'make it look like winter' is a look; no snow falls.",
    "undo": "To undo an edit, begin with it, and give --from the folder of its run: 'undo that'.",
    "rusty": "'rust' and 'rusty red' are colours; rust itself is not drawn.",
    "pastel": "A shade needs a colour: pastel pink.",
    "corner": "Say which: the top right corner, the corner at the left.",
    **dict.fromkeys(
        ("picture", "painting", "image", "photo", "artwork", "drawing"),
        "The picture is given by --editor style --set editor.picture=FILE.",
    ),
    **dict.fromkeys(
        ("everything", "anything", "whatever", "stuff", "things"),
        "Name the things, or mark them by a click or a box.",
    ),
    "half": "Halves are of the picture: the left half.",
    "third": "Thirds are of the picture: the lower third.",
    "quarter": "Quarters are of the picture: the top left quarter.",
}
"""What to say for words that ask for something else than what can be done."""

SPELLINGS = pairs_of(
    "color=colour colors=colours colored=coloured recolor=recolour recolored=recoloured gray=grey "
    "grayish=greyish watercolor=watercolour watercolours=watercolour watercolors=watercolour "
    "center=centre rear=back blacken=black whiten=white repaint=paint teh=the plz=please "
    "pls=please blurry=blurred pixellate=pixelate pixelize=pixelate pixelise=pixelate"
)
"""Words that mean another one."""
