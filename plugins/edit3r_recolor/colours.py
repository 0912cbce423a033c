"""Colour words: CSS names, a few everyday ones, `#rrggbb`, and light or dark before any of them."""

import colorsys

from PIL import ImageColor

_BASIC_NAMES = """
    red orange yellow green blue purple pink brown black white grey turquoise cyan magenta gold silver beige navy teal
    olive maroon violet
"""
BASIC = tuple(_BASIC_NAMES.split())
"""The names that messages suggest."""

_EVERYDAY = {
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
    "ochre": "#cc7722",
    "rose": "#ff007f",
    "ruby": "#9b111e",
    "scarlet": "#ff2400",
    "silvery": "#c0c0c0",
    "terracotta": "#e2725b",
    # As a painter would mix them: CSS's pure primaries are lamps, and its green is very dark.
    "red": "#dc1414",
    "green": "#1e9632",
    "blue": "#1e50dc",
    "yellow": "#ffdc00",
}
_TONES = {"light": 0.45, "pale": 0.6, "pastel": 0.55, "bright": 0.12, "dark": -0.4, "deep": -0.25}


def read_colour(words: list[str]) -> tuple[str, tuple[float, float, float], int] | None:
    """The colour at the start of `words`: its name, sRGB in [0, 1], and how many words it takes; None if there is none.

    The longest reading wins: "light sea green" is one colour.
    """
    for length in (3, 2, 1):
        rgb = _single(words[:length]) if len(words) >= length else None
        if rgb is not None:
            return " ".join(words[:length]), rgb, length
    return None


def _single(words: list[str]) -> tuple[float, float, float] | None:
    rgb = _lookup("".join(words))
    if rgb is None and len(words) > 1 and words[0] in _TONES:
        rest = _lookup("".join(words[1:]))
        rgb = None if rest is None else _toned(rest, _TONES[words[0]])
    return rgb


def _lookup(name: str) -> tuple[float, float, float] | None:
    given = _EVERYDAY.get(name) or (name if name in ImageColor.colormap or name.startswith("#") else None)
    if given is None:
        return None
    try:
        return tuple(level / 255 for level in ImageColor.getrgb(given)[:3])
    except ValueError:  # "#" and letters that are no colour
        return None


def _toned(rgb: tuple[float, float, float], tone: float) -> tuple[float, float, float]:
    """Lighter (tone > 0) or darker (tone < 0), hue kept."""
    hue, lightness, saturation = colorsys.rgb_to_hls(*rgb)
    lightness = lightness + tone * (1 - lightness) if tone > 0 else lightness * (1 + tone)
    return colorsys.hls_to_rgb(hue, lightness, saturation)
