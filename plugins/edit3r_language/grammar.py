"""Reader `grammar`: a closed grammar of English sentences, without learned weights.

A sentence is a row of clauses, split at punctuation, "and", "but", "then" and "while". In a clause
the last group of change words says what to do (`changes`), and the words before it (or after it, as
in "darken the wall") say the thing (`things`, `places`). Clauses without a change share that of a
neighbour ("paint the door and the wall white"), and what is excepted, kept or not to be touched is
taken out of the thing (`together`). Words that are neither change, thing nor filler
(`unknown_words`) make the clause an instruction of action "other" that names them: only an editor
with a model of its own can carry that out.
"""

import difflib
import re
from collections.abc import Iterator

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import Reader
from edit3r.kit.compute.colour_names import near_colours, read_colour
from edit3r_language.clauses import Clause, asks_nothing, read_clause, read_kept
from edit3r_language.known_words import is_known, is_plural, near_nouns
from edit3r_language.targets import read_target
from edit3r_language.together import instructions_of
from edit3r_language.vocabulary import (
    ADJUSTMENTS,
    INSTEAD,
    PHRASES,
    SPELLINGS,
    TINTS,
    WORDS,
)

MAX_WORDS = 80
"""A longer sentence is no plain one; it is left to editors with a model of their own."""

SHORT = 3
"""Letters of a word that is spelt nearly like any other: "pop", "add"."""

_SEPARATORS = re.compile(
    r"([,.;!?:]+|\band\b|\bthen\b|&|\bwhile\b|\bwhereas\b|\bbut\b)"
)
_UNDO = re.compile(
    r"\s*(please )?(undo|revert|take back)"
    r"( (it|that|this|(the|my) (last|previous)( (edit|change|one))?|the (edit|change)))?"
    r"\s*($|([,.;!]|\b(?:and|then|but)\b)([,.;!\s]|and\b|then\b|but\b)*)",
    re.IGNORECASE,
)
_RGB = re.compile(r"\brgb ?\(? ?(\d{1,3})[, ]+(\d{1,3})[, ]+(\d{1,3})\)?")
_TOKEN = re.compile(
    r"#[0-9a-z]+|(?<!\w)-?\d+%|\d+%|[^\W_]+(?:(?:['-]|\s*/\s*)[^\W_]+)*"
)


class GrammarReader(Reader):
    """Knows colours, looks, places and everyday things; other words are named, never guessed."""

    abilities = (
        "Say what it shall become: a colour, gold, wood, brighter, darker, warmer, black and "
        "white, a look (autumn, a pencil sketch); or what to remove, blur or pixelate."
    )

    def read(self, prompt: str) -> tuple[Instruction, ...]:
        typed = prompt.split()
        if len(typed) > MAX_WORDS or max(map(len, typed), default=0) > 200:
            text = " ".join(prompt[:200].split())
            return (Instruction("other", Target("whole"), text=text, unread=("...",)),)
        clauses: list[Clause] = []
        kept: list[Target] = []
        for tokens in clauses_of(prompt):
            if asks_nothing(tokens):
                continue
            things = read_kept(tokens)
            if things is None:
                clauses.append(read_clause(tokens))
            else:
                kept += things
        if not clauses:
            raise PromptError(f"{prompt!r} asks for no change. {self.abilities}")
        return instructions_of(clauses, kept, prompt)

    def after_undo(self, prompt: str) -> str | None:
        found = _UNDO.match(prompt)
        return prompt[found.end() :] if found else None

    def read_target(self, words: str) -> Target:
        return read_target(words.lower().split())

    def hint(self, instruction: Instruction) -> str:
        look = instruction.look.split()
        hints = [f" {INSTEAD[word]}" for word in look if word in INSTEAD]
        for word in instruction.unread:
            if word in INSTEAD:
                hints.append(f" {INSTEAD[word]}")
            elif "/" in word:
                hints.append(f" Say which is meant of {word!r}, or join them by 'and'.")
            elif word.startswith("#"):
                hints.append(" A colour is #ff8800, without digits for its opacity.")
            elif not is_known(word):
                clause = instruction.text.split()
                hints.append(_near(word) or _beside_colour(word, clause))
        named = [] if instruction.unread else instruction.target.name.split()
        hints += [_did_you_mean(near_nouns(word)) for word in named]
        return "".join(hints)


# ---- the clauses of a sentence ----


def clauses_of(prompt: str) -> Iterator[list[str]]:
    """The words of each clause, lower-case, with spellings and set phrases brought to one form."""
    text = _RGB.sub(_hex_of, prompt.lower().replace("’", "'"))
    for pattern, instead in PHRASES:
        text = " ".join(pattern.sub(instead, text).split())
    text, begins = _exceptions(text), True
    for part in _SEPARATORS.split(text):
        tokens = [SPELLINGS.get(token, token) for token in _TOKEN.findall(part)]
        tokens = [piece for token in tokens for piece in _pieces(token)]
        while len(tokens) > 1 and tokens[0] in WORDS.openings:
            tokens = tokens[1:]
        if tokens and not _SEPARATORS.fullmatch(part):
            yield _wished_away(_parts_before(tokens), begins)
            begins = False


def _hex_of(match: re.Match) -> str:
    """ "rgb(255, 136, 0)" as "#ff8800"; as it is with a number beyond 255."""
    numbers = [int(number) for number in match.groups()]
    code = "".join(f"{number:02x}" for number in numbers)
    return f"#{code}" if max(numbers) < 256 else match.group()


def _wished_away(tokens: list[str], begins: bool) -> list[str]:
    """Write "no people", and "without the plant", with which a sentence begins, as a removal."""
    named = [token for token in tokens[1:] if token not in WORDS.politeness]
    if not begins or tokens[0] not in ("no", "without") or not named:
        return tokens
    several = is_plural(named[-1])
    return ["remove", *tokens[1:]] if several or named[0] == "the" else tokens


def _parts_before(tokens: list[str]) -> list[str]:
    """Write "everything that is red" as "everything red parts"."""
    if "thatis" not in tokens:
        return tokens
    start = tokens.index("thatis")
    found = read_colour(tokens[start + 1 :])
    if found is None:
        return [token for token in tokens if token != "thatis"]
    end = start + 1 + found[1]
    return [*tokens[:start], *tokens[start + 1 : end], "parts", *tokens[end:]]


def _exceptions(text: str) -> str:
    """Write "but" as "except" in "everything but the bear" and "remove the cups but the left one".

    Not where a new clause begins with it.
    """
    whole = "|".join(sorted(WORDS.whole | WORDS.rest))
    remove = "|".join(sorted(WORDS.remove))
    after = "not|don't|keep|leave|make|paint|turn|the rest"
    return re.sub(
        rf"\b({whole}|{remove})\b([^,.;]*?)\bbut (?!{after})", r"\1\2except ", text
    )


def _pieces(token: str) -> list[str]:
    """The parts of "dark-blue" and "coal-black"; other words with a hyphen stay whole."""
    parts = token.split("-")
    known = read_colour(parts[-1:]) is not None or parts[-1] in WORDS.sizes
    return parts if len(parts) > 1 and (known or parts[-1] in WORDS.shares) else [token]


# ---- what to say instead ----


def _beside_colour(word: str, clause: list[str]) -> str:
    """What to say for a word before a colour, which is no shade that is known."""
    after = clause[clause.index(word) + 1 :] if word in clause else []
    if read_colour(after) is None:
        return ""
    return (
        f" {word!r} is no shade of colour that is known; where it belongs to the thing, say "
        f"'into {after[0]}'."
    )


def _near(word: str) -> str:
    """Asks for words that are spelt nearly like one that nobody knows, colours first."""
    verbs = WORDS.remove | WORDS.hide | WORDS.paint | WORDS.imperatives | WORDS.looks
    known = [*verbs, *ADJUSTMENTS, *TINTS]
    near = []
    if len(word) > SHORT:
        near = [*near_colours(word), *difflib.get_close_matches(word, known, 2, 0.75)]
    return _did_you_mean([*near, *near_nouns(word)][:4])


def _did_you_mean(near: list[str]) -> str:
    return f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
