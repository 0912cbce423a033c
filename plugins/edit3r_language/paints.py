"""Paint in words: a colour or a material, and how its light shall be ("matte black")."""

from dataclasses import dataclass, replace

from edit3r.contract.instructions import Change, Colour, Finish
from edit3r.kit.compute.colour_names import COMPARED, read_colour
from edit3r_language.vocabulary import pairs_of, words_of

MATERIALS = pairs_of(
    "gold=gold golden=gold gilded=gold silver=silver silvery=silver bronze=bronze copper=copper "
    "chrome=chrome steel=steel marble=marble wood=wood wooden=wood snow=snow snowy=snow"
)
"""Words for what a thing may look as if it were made of."""

_MATERIAL_COLOURS = {"gilded": "gold", "wooden": "wood"}
_SNOW = (0.96, 0.97, 1.0)

FINISHES: dict[str, Finish] = {
    "matte": "matte",
    "matt": "matte",
    "metallic": "metallic",
}
"""How light lies on paint, where an editor of colours can do it."""

NO_FINISHES = words_of(
    "glossy gloss shiny satin polished lacquered glittery glittering sparkly sparkling "
    "iridescent pearlescent"
)
"""Where it cannot: highlights that no photo shows are not invented."""

LIGHT_WORDS = frozenset(FINISHES) | NO_FINISHES

_WINDOW = 8  # words that a paint may take


@dataclass(frozen=True)
class PaintWords:
    """A paint, the number of words that name it, and those of them that nobody can do."""

    change: Change
    length: int
    left_out: tuple[str, ...] = ()


def read_paint(words: list[str]) -> PaintWords | None:
    """The paint at the start of `words`: "gold", "white marble", "light metallic grey, shiny"."""
    window = words[:_WINDOW]
    places = [i for i, word in enumerate(window) if word not in LIGHT_WORDS]
    found = _read_plain([window[place] for place in places])
    if found is None:
        return None
    change, length = found
    end = places[length - 1] + 1
    while end < len(window) and window[end] in LIGHT_WORDS:
        end += 1
    finishes = [FINISHES[word] for word in window[:end] if word in FINISHES]
    left_out = tuple(word for word in window[:end] if word in NO_FINISHES)
    if finishes:
        change = replace(change, finish=finishes[-1])
    return PaintWords(change, end, left_out)


def _read_plain(words: list[str]) -> tuple[Change, int] | None:
    """A material or a colour, without words about light."""
    if words and words[0] in MATERIALS:
        return _material(words[0]), 1
    found = read_colour(words)
    if found is None:
        return None
    colour, length = found
    if words[length : length + 1] and words[length] in MATERIALS:  # "white marble"
        name = f"{colour.name} {words[length]}"
        material = MATERIALS[words[length]]
        return Change("paint", Colour(name, colour.rgb), material=material), length + 1
    change = Change("paint", colour)
    if length > 1 and words[0] in COMPARED:  # "a darker green"
        change = replace(change, than_now=COMPARED[words[0]])
    return change, length


def _material(word: str) -> Change:
    known = read_colour([_MATERIAL_COLOURS.get(word, word)])
    rgb = _SNOW if known is None else known[0].rgb
    return Change("paint", Colour(word, rgb), material=MATERIALS[word])
