"""Read a prompt into requests: a closed grammar that says so when a sentence is outside it.

A prompt is a row of clauses ("paint the door green and the wall white"). In each, the last group of
change words is what to do and the words before it (or after it, for "darken the wall") are the
thing; things in a row share a change ("the door and the wall white"). "Everything except the bear"
turns the place around; "from grey to brown" changes only pixels near the first colour. Whatever is
neither a change, a thing in its place nor a filler word is an error, so that no part of an
instruction is silently dropped.
"""

import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from edit3r.errors import PromptError
from edit3r_recolor import vocabulary as words
from edit3r_recolor.steps import Adjust, Paint, Sample, Step, Tint
from edit3r_recolor.vocabulary import BASIC_COLOURS, read_colour

ABILITIES = (
    "The recolor editor can paint (paint the bike red, turn the wall light blue; CSS colour "
    "names or #rrggbb; from "
    "grey to brown; everything but the bike), make brighter, darker, warmer, colder, redder, "
    "greener, bluer, more or "
    "less saturated, more or less contrast, greyscale (black and white), sepia, inverted, or "
    "recolor at random. For "
    "anything else take another editor."
)
TINT_SHARE = 0.35

Scope = Literal["object", "everything", "background", "all but"]


@dataclass(frozen=True)
class Instruction:
    """One thing of a prompt and what to do with it."""

    steps: tuple[Step, ...]  # in order
    scope: Scope
    subject: tuple[
        str, ...
    ] = ()  # words for the object, such as ("bike",); only a segmenter can look them up
    near: Paint | None = None  # only pixels near this colour change; None: all
    words: tuple[str, ...] = ()  # of the prompt, that say all this

    def __str__(self) -> str:
        named = " ".join(self.subject) or (
            "all" if self.scope == "everything" else self.scope
        )
        thing = f"all but {named}" if self.scope == "all but" else named
        where = f" where it is near {self.near.colour}" if self.near else ""
        return f"{thing}{where}: {', '.join(map(_in_words, self.steps))}"


def _in_words(step: Step) -> str:
    values = [
        v if isinstance(v, str) else f"{v:+.2g}"
        for v in vars(step).values()
        if not isinstance(v, tuple)
    ]
    return " ".join(values) or "colours drawn by the seed"


@dataclass(frozen=True)
class _Change:
    """A step found at tokens[start:end]."""

    start: int
    end: int
    step: Step


def parse_prompt(prompt: str) -> tuple[Instruction, ...]:
    """Read what `prompt` asks for, one instruction a place, in the order of the sentence. Raises
    PromptError.
    """
    if not prompt.strip():
        raise PromptError(
            "nothing is asked for; say it with --prompt, or take --editor none for the photos "
            f"as they are. {ABILITIES}"
        )
    clauses = [
        tokens
        for tokens in _clauses(prompt)
        if not _keeps(tokens) and not set(tokens) <= words.POLITENESS
    ]
    if not clauses:
        raise PromptError(f"{prompt!r} asks for no change of colour. {ABILITIES}")
    found: dict[tuple, list[Instruction]] = {}  # by place
    place: tuple = ()
    for read in _reads(clauses, prompt):
        if not (
            place and read.near is None and set(read.subject) <= words.PRONOUNS
        ):  # else: it is what was named last
            place = (*_place(read), read.near)
        found.setdefault(place, []).append(read)
    return tuple(_together(place, reads, prompt) for place, reads in found.items())


def _reads(clauses: list[list[str]], prompt: str) -> Iterator[Instruction]:
    """Read each clause; those that only name things get what the next one asks for, at the end what
    the last one did.

    That needs the change to be said first there, as in "darken the door and the wall".
    """
    names = [_content(tokens) if _only_names(tokens) else () for tokens in clauses]
    last = max((i for i, named in enumerate(names) if not named), default=0)
    if clauses[last][0] in words.IMPERATIVES | words.RECOLOUR:
        clauses, names = (
            [*row[:last], *row[last + 1 :], row[last]] for row in (clauses, names)
        )
    names[-1] = ()  # where nothing follows, a thing alone is refused below
    waiting: list[tuple[str, ...]] = []
    for tokens, named in zip(clauses, names):
        if named:
            waiting.append(named)
            continue
        read = _parse_clause(tokens, prompt)
        said = tuple(word for word in read.words if word not in read.subject)
        yield from (
            replace(read, subject=own, scope="object", words=(*own, *said))
            for own in waiting
        )
        if read.subject or not waiting:  # else: "paint the bear, please, red"
            yield read
        waiting = []


def _only_names(tokens: list[str]) -> bool:
    """Tell whether a clause only names a thing: "paint the old door", and after other verbs a
    single word.
    """
    says_more = set(tokens) & (
        words.UNSUPPORTED | words.NEGATIONS | words.MORE | words.LESS | {"from"}
    )
    if says_more or _changes(tokens) or words.EXCEPTION.search(" ".join(tokens)):
        return False
    return len(_content(tokens)) == 1 or (
        tokens[0] in words.PAINTING and bool(_content(tokens))
    )


def _together(place: tuple, reads: list[Instruction], prompt: str) -> Instruction:
    """Make the clauses about one place one instruction."""
    # Painting first: adjusting a colour that is then painted over would be lost.
    steps = sorted(
        (step for read in reads for step in read.steps),
        key=lambda step: not isinstance(step, Paint),
    )
    if sum(isinstance(step, Paint) for step in steps) > 1:
        raise PromptError(
            f"{prompt!r} asks for two colours at once; name one, or what else gets the other."
        )
    return Instruction(
        tuple(steps), *place, tuple(word for read in reads for word in read.words)
    )


def _clauses(prompt: str) -> list[list[str]]:
    """Split a prompt into clauses of lower-case words."""
    text = prompt.lower().replace("’", "'")
    text = re.sub(
        r"\bblack\s*(?:and|&|-and-|/)\s*white\b|\bb\s*&\s*w\b|\bgr[ea]y[\s-]scale\b",
        " greyscale ",
        text,
    )
    text = re.sub(r"\bdo not\b", "don't", text)
    text = words.REPLACED.sub(
        lambda m: f"from {m[1]} to" if read_colour([m[1]]) else m[0], text
    )
    if kept := words.KEPT_THING.search(
        text
    ):  # satisfied by itself where another thing is painted
        text, whole = words.ALL_AROUND.subn("everything", text[: kept.start()], count=1)
        text += f" except the {kept[1]}" if whole else ""
    parts = re.split(r"[,.;!?:]+|\band\b|\bthen\b|&", text)
    return [
        tokens
        for part in parts
        if (tokens := re.findall(r"#[0-9a-z]+|[^\W_]+(?:'[a-z]+)?", part))
    ]


def _keeps(tokens: list[str]) -> bool:
    """Tell whether a clause only asks to keep what is kept in any case."""
    return (
        tokens[0] in ("keep", "leave", "keeping", "leaving")
        and set(tokens[1:]) <= words.KEPT_ANYWAY
    )


def _parse_clause(tokens: list[str], prompt: str) -> Instruction:
    """Read one clause; its subject holds the words as they are, pronouns too."""
    said, text = tokens, " ".join(tokens)
    tokens = words.EXCEPTION.sub(
        r"\1 the", text, count=1
    ).split()  # what is excepted stands there as the thing
    all_but = tokens != said
    tokens, near = _without_origin(tokens)
    if negations := [token for token in tokens if token in words.NEGATIONS]:
        raise PromptError(
            f"{negations[0]!r} in {prompt!r}: negations are not understood; say what should "
            f"change. {ABILITIES}"
        )
    _refuse_words([token for token in tokens if token in words.UNSUPPORTED], prompt)
    changes = _changes(tokens)
    if not changes:
        raise PromptError(
            f"No change of colour found in {prompt!r}.{_spelling_hint(tokens)} {ABILITIES}"
        )
    group = _last_group(changes, tokens)
    before = _content(tokens[: group[0].start])
    after = _content(tokens[group[-1].end :])
    if after and (before or not _may_stand_before(group[-1], tokens)):
        raise PromptError(
            f"Cannot carry out {' '.join(after)!r} in {prompt!r}. {ABILITIES}"
        )
    subject = before or after
    _refuse_words([word for word in subject if word in words.MORE | words.LESS], prompt)
    if near is None and _is_colour(subject, tokens):  # "turn red into blue"
        near, subject = Paint(*read_colour(list(subject))[:2]), ()
    if all_but and not subject:
        raise PromptError(f"{prompt!r} does not say what is left as it is. {ABILITIES}")
    amount = (
        0.5 if set(tokens) & words.WEAK else 1.7 if set(tokens) & words.STRONG else 1.0
    )
    steps = tuple(_scaled(change.step, amount) for change in group)
    used = tuple(
        token
        for token in said
        if token not in words.FILLERS or (all_but and token == "but")
    )
    return Instruction(steps, "all but" if all_but else "object", subject, near, used)


def _without_origin(tokens: list[str]) -> tuple[list[str], Paint | None]:
    """Take "from COLOUR", or "instead of COLOUR", out of a clause."""
    for start, token in enumerate(tokens):
        after = start + (1 if token == "from" else 2)
        if token == "from" or tokens[start:after] == ["instead", "of"]:
            colour = read_colour(tokens[after:])
            if colour is not None:
                return [*tokens[:start], *tokens[after + colour[2] :]], Paint(
                    *colour[:2]
                )
    return tokens, None


def _refuse_words(found: list[str], prompt: str) -> None:
    if found:
        raise PromptError(f"Cannot carry out {found[0]!r} in {prompt!r}. {ABILITIES}")


def _spelling_hint(tokens: list[str]) -> str:
    """Suggest a word that may be meant; only a very near one, since most unknown words name
    objects.
    """
    known = [*words.ADJUSTMENTS, *words.TINTS, *BASIC_COLOURS]
    for token in tokens:
        near = difflib.get_close_matches(token, known, n=1, cutoff=0.8)
        if near and token not in words.FILLERS:
            return f" Did you mean {near[0]!r}?"
    return ""


def _is_colour(subject: tuple[str, ...], tokens: list[str]) -> bool:
    """Tell whether a subject is only a colour, as in "turn red into blue", and not a thing, as in
    "the orange".
    """
    colour = read_colour(list(subject))
    if colour is None or colour[2] != len(subject):
        return False
    start = tokens.index(subject[0])
    return start == 0 or tokens[start - 1] not in words.DETERMINERS


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
    return _Change(start, start + 1, Sample()) if rest[0] in words.RECOLOUR else None


def _more_or_less(rest: list[str], start: int) -> _Change | None:
    """Read "more saturated", "increase the brightness", "less contrast", "more blue"."""
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
    if (
        colour is not None and rest[0] == "more" and word in BASIC_COLOURS
    ):  # "more snow" is no colour
        name, rgb, length = colour
        return _Change(start, start + 1 + length, Tint(name, rgb, TINT_SHARE))
    return None


def _last_group(changes: list[_Change], tokens: list[str]) -> list[_Change]:
    """Return the last changes with nothing but degree words between them; earlier ones describe the
    object.
    """
    group = [changes[-1]]
    for change in reversed(changes[:-1]):
        between = tokens[change.end : group[0].start]
        two_colours = isinstance(change.step, Paint) and any(
            isinstance(c.step, Paint) for c in group
        )
        if two_colours or not set(between) <= words.WEAK | words.STRONG | {"a"}:
            break
        group.insert(0, change)
    return group


def _content(tokens: list[str]) -> tuple[str, ...]:
    """Return the words that are neither fillers nor degrees; "the bear's" colour is the bear's."""
    found = [
        t
        for t in tokens
        if t not in words.FILLERS | words.WEAK | words.STRONG | words.RECOLOUR
    ]
    return tuple((*found[:-1], found[-1].removesuffix("'s"))) if found else ()


def _may_stand_before(change: _Change, tokens: list[str]) -> bool:
    """Tell whether an object may follow: "darken walls", "more contrast in the sky", "paint red the
    bike".
    """
    follows = tokens[change.end : change.end + 2]
    if tokens[change.start] in words.IMPERATIVES | words.RECOLOUR:
        return True
    return bool(follows) and (
        follows[0] in words.DETERMINERS or (follows[0] == "in" and follows[-1] == "the")
    )


def _scaled(step: Step, amount: float) -> Step:
    if isinstance(step, Adjust):
        return replace(step, amount=step.amount * amount)
    return (
        replace(step, amount=min(1.0, step.amount * amount))
        if isinstance(step, Tint)
        else step
    )


def _place(read: Instruction) -> tuple[Scope, tuple[str, ...]]:
    """Say where a clause applies; without a thing, colours go on the object and adjustments on
    everything.
    """
    subject = set(read.subject)
    named = tuple(
        word
        for word in read.subject
        if word not in words.PRONOUNS | words.OBJECT_WORDS | words.EVERYTHING
    )
    if named:
        return (
            ("background", ())
            if set(named) <= words.BACKGROUND
            else (read.scope, named)
        )
    if subject & words.EVERYTHING or (read.near is not None and not subject):
        return "everything", ()
    painted = subject & words.OBJECT_WORDS or any(
        isinstance(step, Paint | Sample) for step in read.steps
    )
    return (read.scope if painted or read.scope == "all but" else "everything"), ()
