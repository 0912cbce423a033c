"""Cut a sentence into clauses of plain words."""

import re
from collections.abc import Iterator

from edit3r.kit.compute.colour_names import read_colour
from edit3r_language import vocabulary as words

_SEPARATORS = re.compile(
    r"([,.;!?:]+|\band\b|\bthen\b|&|\bwhile\b|\bwhereas\b|\bbut\b)"
)
_TOKEN = re.compile(r"#[0-9a-z]+|[^\W_]+(?:['-][^\W_]+)*")


def clauses_of(prompt: str) -> Iterator[list[str]]:
    """The words of each clause, lower-case, with spellings and set phrases brought to one form."""
    text = prompt.lower().replace("’", "'")
    for pattern, instead in words.PHRASES:
        text = " ".join(re.sub(pattern, instead, text).split())
    text = _exceptions(text)
    for part in _SEPARATORS.split(text):
        tokens = [words.SPELLINGS.get(token, token) for token in _TOKEN.findall(part)]
        tokens = [piece for token in tokens for piece in _pieces(token)]
        while len(tokens) > 1 and tokens[0] in words.OPENINGS:
            tokens = tokens[1:]
        if tokens and not _SEPARATORS.fullmatch(part):
            yield _parts_before(tokens)


def _parts_before(tokens: list[str]) -> list[str]:
    """Write "everything that is red" as "everything red parts"."""
    if "thatis" not in tokens:
        return tokens
    start = tokens.index("thatis")
    found = read_colour(tokens[start + 1 :])
    if found is None:
        return [token for token in tokens if token != "thatis"]
    colour, length = found
    if colour.name not in words.BASIC and length > 1:  # "that is red blue"
        colour, length = read_colour(tokens[start + 1 : start + 2]) or found
    end = start + 1 + length
    return [*tokens[:start], *tokens[start + 1 : end], "parts", *tokens[end:]]


def _exceptions(text: str) -> str:
    """Write "but" as "except" in "everything but the bear" and "remove the cups but the left one".

    Not where a new clause begins with it.
    """
    whole = "|".join(sorted(words.WHOLE | words.REST))
    remove = "|".join(sorted(words.REMOVE))
    after = "not|don't|keep|leave|make|paint|turn|the rest"
    return re.sub(
        rf"\b({whole}|{remove})\b([^,.;]*?)\bbut (?!{after})", r"\1\2except ", text
    )


def _pieces(token: str) -> list[str]:
    """The parts of "dark-blue" and "coal-black"; other words with a hyphen stay whole."""
    parts = token.split("-")
    known = read_colour(parts[-1:]) is not None or parts[-1] in words.SIZES
    return parts if len(parts) > 1 and (known or parts[-1] in words.SHARES) else [token]
