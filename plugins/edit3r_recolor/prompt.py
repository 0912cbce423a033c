"""Read a prompt into a `Wish`: a closed grammar that says so when a sentence is outside it.

A prompt is a row of clauses ("paint the bike red and make it darker"). In each, the last group of change words is
what to do and the words before it (or after it, for "darken the wall") are the object. Whatever is neither a change,
an object in its place nor a filler word is an error, so that no part of an instruction is silently dropped.
"""

import difflib
import re
from dataclasses import dataclass, replace

from edit3r.errors import PromptError
from edit3r_recolor import vocabulary as words
from edit3r_recolor.colours import BASIC, read_colour
from edit3r_recolor.wish import Adjust, Paint, Sample, Scope, Step, Tint, Wish

ABILITIES = (
    "The recolor editor can paint (paint the bike red, turn the wall light blue; CSS colour names or #rrggbb), make "
    "brighter, darker, warmer, colder, redder, greener, bluer, more or less saturated, more or less contrast, "
    "greyscale (black and white), sepia, inverted, or recolor at random. For anything else take another editor."
)
TINT_SHARE = 0.35


@dataclass(frozen=True)
class _Change:
    """A step found at tokens[start:end]."""

    start: int
    end: int
    step: Step


def read_prompt(prompt: str) -> Wish:
    """What `prompt` asks for; an empty prompt asks for a sampled recolouring of the object. Raises PromptError."""
    if not prompt.strip():
        return Wish((Sample(),), "object")
    clauses = [tokens for tokens in _clauses(prompt) if not _keeps(tokens) and not set(tokens) <= words.POLITENESS]
    if not clauses:
        raise PromptError(f"{prompt!r} asks for no change of colour. {ABILITIES}")
    steps: list[Step] = []
    places: list[tuple[Scope, tuple[str, ...]]] = []
    for tokens in clauses:
        clause_steps, subject = _read_clause(tokens, prompt)
        steps += clause_steps
        if subject or not places:
            places.append(_place(subject, clause_steps))
    if len(set(places)) > 1:
        listed = " and ".join(repr(" ".join(subject) or scope) for scope, subject in dict.fromkeys(places))
        raise PromptError(f"{prompt!r} names {listed}; the recolor editor changes one region at a time. Run it twice.")
    # Painting first: adjusting a colour that is then painted over would be lost.
    ordered = sorted(steps, key=lambda step: not isinstance(step, Paint))
    if sum(isinstance(step, Paint) for step in ordered) > 1:
        raise PromptError(f"{prompt!r} asks for two colours at once; name one.")
    scope, subject = places[0]
    return Wish(tuple(ordered), scope, subject)


def _clauses(prompt: str) -> list[list[str]]:
    text = prompt.lower().replace("’", "'")
    text = re.sub(r"\bblack\s*(?:and|&|-and-|/)\s*white\b|\bb\s*&\s*w\b|\bgr[ea]y[\s-]scale\b", " greyscale ", text)
    text = re.sub(r"\bdo not\b", "don't", text)
    parts = re.split(r"[,.;!?:]+|\band\b|\bthen\b|&", text)
    return [tokens for part in parts if (tokens := re.findall(r"#[0-9a-z]+|[^\W_]+(?:'[a-z]+)?", part))]


def _keeps(tokens: list[str]) -> bool:
    """Whether the clause only asks to keep what is kept in any case."""
    return tokens[0] in ("keep", "leave", "keeping", "leaving") and set(tokens[1:]) <= words.KEPT_ANYWAY


def _read_clause(tokens: list[str], prompt: str) -> tuple[list[Step], tuple[str, ...]]:
    """Steps and subject words of one clause."""
    _refuse(tokens, prompt)
    changes = _changes(tokens)
    if not changes:
        raise PromptError(f"No change of colour found in {prompt!r}.{_hint(tokens)} {ABILITIES}")
    group = _last_group(changes, tokens)
    before = _content(tokens[: group[0].start])
    after = _content(tokens[group[-1].end :])
    if after and (before or not _may_stand_before(group[-1], tokens)):
        raise PromptError(f"Cannot carry out {' '.join(after)!r} in {prompt!r}. {ABILITIES}")
    subject = before or after
    _refuse_subject(subject, tokens, prompt)
    amount = _amount(tokens)
    return [_scaled(change.step, amount) for change in group], subject


def _hint(tokens: list[str]) -> str:
    """A word that may have been misspelt; only very near ones, since most unknown words name objects."""
    known = [*words.ADJUSTMENTS, *words.TINTS, *BASIC]
    for token in tokens:
        near = difflib.get_close_matches(token, known, n=1, cutoff=0.8)
        if near and token not in words.FILLERS:
            return f" Did you mean {near[0]!r}?"
    return ""


def _refuse(tokens: list[str], prompt: str) -> None:
    negation = next((token for token in tokens if token in words.NEGATIONS), None)
    if negation is not None:
        raise PromptError(
            f"{negation!r} in {prompt!r}: negations are not understood; say what should change. {ABILITIES}"
        )
    unsupported = next((token for token in tokens if token in words.UNSUPPORTED), None)
    if unsupported is not None:
        raise PromptError(f"Cannot carry out {unsupported!r} in {prompt!r}. {ABILITIES}")


def _refuse_subject(subject: tuple[str, ...], tokens: list[str], prompt: str) -> None:
    degree = next((word for word in subject if word in words.MORE | words.LESS), None)
    if degree is not None:
        raise PromptError(f"Cannot carry out {degree!r} in {prompt!r}. {ABILITIES}")
    colour = read_colour(list(subject))
    is_noun = (
        bool(subject) and tokens.index(subject[0]) > 0 and tokens[tokens.index(subject[0]) - 1] in words.DETERMINERS
    )
    if colour is not None and colour[2] == len(subject) and not is_noun:
        raise PromptError(f"{prompt!r} picks a region by its colour, which the recolor editor cannot. {ABILITIES}")


def _changes(tokens: list[str]) -> list[_Change]:
    found, index = [], 0
    while index < len(tokens):
        change = _change_at(tokens, index)
        found += [change] if change else []
        index = change.end if change else index + 1
    return found


def _change_at(tokens: list[str], start: int) -> _Change | None:
    rest = tokens[start:]
    if rest[0] in words.MORE | words.LESS:
        return _more_or_less(rest, start)
    colour = read_colour(rest)
    if colour is not None:
        name, rgb, length = colour
        return _Change(start, start + length, Paint(name, rgb))
    if rest[0] in words.TINTS:
        name, rgb, _ = read_colour([words.TINTS[rest[0]]])
        return _Change(start, start + 1, Tint(name, rgb, TINT_SHARE))
    if rest[0] in words.ADJUSTMENTS:
        return _Change(start, start + 1, words.ADJUSTMENTS[rest[0]])
    if rest[0] in words.RECOLOUR:
        return _Change(start, start + 1, Sample())
    return None


def _more_or_less(rest: list[str], start: int) -> _Change | None:
    """ "more saturated", "increase the brightness", "less contrast", "more blue"."""
    sign = 1.0 if rest[0] in words.MORE else -1.0
    skip = 2 if rest[1:2] == ["the"] else 1
    word = rest[skip] if len(rest) > skip else ""
    end = start + skip + 1
    if word in words.PROPERTIES:
        return _Change(start, end, Adjust(words.PROPERTIES[word], sign))
    if word in words.ADJUSTMENTS:
        known = words.ADJUSTMENTS[word]
        return _Change(start, end, replace(known, amount=sign * known.amount))
    colour = read_colour(rest[1:])
    if colour is not None and rest[0] == "more" and word in BASIC:  # "more snow" is no colour
        name, rgb, length = colour
        return _Change(start, start + 1 + length, Tint(name, rgb, TINT_SHARE))
    return None


def _last_group(changes: list[_Change], tokens: list[str]) -> list[_Change]:
    """The last changes with nothing but degree words between them; earlier ones describe the object."""
    group = [changes[-1]]
    for change in reversed(changes[:-1]):
        between = tokens[change.end : group[0].start]
        two_colours = isinstance(change.step, Paint) and any(isinstance(c.step, Paint) for c in group)
        if two_colours or not set(between) <= words.WEAK | words.STRONG | {"a"}:
            break
        group.insert(0, change)
    return group


def _content(tokens: list[str]) -> tuple[str, ...]:
    """The words that are neither fillers nor degrees."""
    return tuple(t for t in tokens if t not in words.FILLERS | words.WEAK | words.STRONG)


def _may_stand_before(change: _Change, tokens: list[str]) -> bool:
    """Whether an object may follow the change: "darken walls", "more contrast in the sky", "paint red the bike"."""
    follows = tokens[change.end : change.end + 2]
    if tokens[change.start] in words.IMPERATIVES | words.RECOLOUR:
        return True
    return bool(follows) and (follows[0] in words.DETERMINERS or (follows[0] == "in" and follows[-1] == "the"))


def _amount(tokens: list[str]) -> float:
    weak, strong = set(tokens) & words.WEAK, set(tokens) & words.STRONG
    return 0.5 if weak else 1.7 if strong else 1.0


def _scaled(step: Step, amount: float) -> Step:
    if isinstance(step, Adjust):
        return replace(step, amount=step.amount * amount)
    if isinstance(step, Tint):
        return replace(step, amount=min(1.0, step.amount * amount))
    return step


def _place(subject: tuple[str, ...], steps: list[Step]) -> tuple[Scope, tuple[str, ...]]:
    """Where a clause applies; without an object, colours go on the object and adjustments on everything."""
    named = tuple(word for word in subject if word not in words.PRONOUNS | words.OBJECT_WORDS | words.EVERYTHING)
    if named and set(named) <= words.BACKGROUND:
        return "background", ()
    if named:
        return "object", named
    if set(subject) & words.EVERYTHING:
        return "everything", ()
    if set(subject) & words.OBJECT_WORDS:
        return "object", ()
    return ("object" if any(isinstance(step, Paint | Sample) for step in steps) else "everything"), ()
