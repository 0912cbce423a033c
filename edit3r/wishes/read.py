"""Read a sentence into wishes.

The reader is a closed grammar. A sentence is a row of clauses, split at punctuation, "and", "but",
"then" and "while". In a clause the last group of change words says what to do, and the words before
it (or after it, as in "darken the wall") say the thing. Clauses without a change share that of a
neighbour ("paint the door and the wall white"). What is excepted, kept or not to be touched is
taken out of the thing. Words that are neither change, thing nor filler make the clause a wish of
action "other" that names them: only an editor with a model of its own can carry that out.
"""

import difflib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from edit3r.contract.errors import PromptError
from edit3r.contract.wishes import Action, Change, Colour, Thing, Wish
from edit3r.wishes import vocabulary as words
from edit3r.wishes.things import read_thing

ABILITIES = (
    "Without learned weights these are understood: paint (paint the bike red; from grey to brown; "
    "only the red parts; everything but the bike; gold, silver, bronze, wood, marble, snow), "
    "brighter, darker, warmer, colder, more or less saturated or contrast, black and white, sepia, "
    "inverted, looks (as a pencil sketch, like autumn), and remove (remove the bin)."
)

MAX_WORDS = 80
"""A longer sentence is no plain wish; what it says is left to editors with a model of their own."""

_SEPARATORS = re.compile(
    r"([,.;!?:]+|\band\b|\bthen\b|&|\bwhile\b|\bwhereas\b|\bbut\b)"
)
_TOKEN = re.compile(r"#[0-9a-z]+|[^\W_]+(?:['-][^\W_]+)*")


@dataclass
class _Clause:
    """What one clause says; parts that it leaves open are filled in from its neighbours."""

    text: str
    action: Action | None = None  # None where the clause only names things
    thing: Thing | None = None
    changes: tuple[Change, ...] = ()
    look: str = ""
    without: list[Thing] = field(default_factory=list)
    unread: tuple[str, ...] = ()
    verb_first: bool = False  # "remove the bin": things may follow in the next clauses


def read(prompt: str) -> tuple[Wish, ...]:
    """The wishes of a sentence, in its order.

    Raises PromptError for a sentence that asks for nothing, or for two colours on one thing.
    """
    if not prompt.strip():
        raise PromptError(
            "nothing is asked for; say it with --prompt, or take --editor none for the photos as "
            f"they are. {ABILITIES}"
        )
    said = prompt.split()
    if len(said) > MAX_WORDS or max(map(len, said)) > 200:
        return (
            Wish(
                "other",
                Thing("whole"),
                text=" ".join(prompt[:200].split()),
                unread=("...",),
            ),
        )
    clauses: list[_Clause] = []
    kept: list[Thing] = []
    for tokens in _clauses(prompt):
        if _asks_nothing(tokens):
            continue
        things = _kept(tokens)
        if things is None:
            clauses.append(_read_clause(tokens))
        else:
            kept += things
    if not clauses:
        raise PromptError(f"{prompt!r} asks for no change. {ABILITIES}")
    wishes = _merged(_resolved(_shared(clauses), kept), prompt)
    return tuple(_with_rest(wishes))


def spelling_hint(wish: Wish) -> str:
    """' Did you mean ...?' for a word of a wish that nearly is a colour or another change."""
    known = [*words.ADJUSTMENTS, *words.TINTS, *words.BASIC_COLOURS, *words.LOOKS]
    for word in wish.unread or wish.text.split():
        near = difflib.get_close_matches(word, known, n=1, cutoff=0.8)
        if near and word not in words.FILLERS and word not in known:
            return f" Did you mean {near[0]!r}?"
    return ""


# ---- clauses ----


def _clauses(prompt: str) -> Iterator[list[str]]:
    """The words of each clause, lower-case, with spellings and set phrases brought to one form."""
    text = prompt.lower().replace("’", "'")
    for pattern, instead in words.PHRASES:
        text = re.sub(pattern, instead, text)
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
    found = words.read_colour(tokens[start + 1 :])
    if found is None:
        return [token for token in tokens if token != "thatis"]
    end = start + 1 + found[1]
    return [*tokens[:start], *tokens[start + 1 : end], "parts", *tokens[end:]]


def _exceptions(text: str) -> str:
    """Write "but" as "except" in "everything but the bear", where no new clause begins with it."""
    whole = "|".join(sorted(words.WHOLE | words.REST))
    after = "not|don't|keep|leave|make|paint|turn|the rest"
    return re.sub(rf"\b({whole})\b([^,.;]*?)\bbut (?!{after})", r"\1\2except ", text)


def _pieces(token: str) -> list[str]:
    """The parts of "dark-blue" and "coal-black"; other words with a hyphen stay whole."""
    parts = token.split("-")
    known = all(words.read_colour([part]) or part in words.SIZES for part in parts[-1:])
    return parts if len(parts) > 1 and known else [token]


def _asks_nothing(tokens: list[str]) -> bool:
    """Politeness, or "not blue" beside another colour."""
    if set(tokens) <= words.POLITENESS | words.NOTHING:
        return True
    negated = tokens[0] in words.NEGATIONS and len(tokens) > 1
    return negated and words.read_colour(tokens[1:]) is not None


def _kept(tokens: list[str]) -> list[Thing] | None:
    """The things that a clause wants left as they are; None for a clause of another kind."""
    staying = next((i for i, token in enumerate(tokens) if token in words.STAYS), 0)
    if staying:  # "the tank stays red"
        tokens = ["keep", *tokens[:staying]]
    keeps = tokens[0] in words.KEEP
    negates = tokens[0] in words.NEGATIONS
    if negates and len(tokens) > 1 and tokens[1] in words.TOUCH:
        tokens = tokens[1:]
    elif not keeps and not negates:
        return None
    content = [t for t in tokens[1:] if t not in words.FILLERS | words.AS_IT_IS]
    if set(content) <= words.KEPT_ANYWAY - words.BACKGROUND:
        return []
    if keeps and tokens[-1] in words.ADJUSTMENTS | words.TINTS:
        return None
    if negates and _changes(tokens):  # "don't paint the bike red"
        return None
    return [read_thing([t for t in tokens[1:] if t not in words.AS_IT_IS])]


def _read_clause(tokens: list[str]) -> _Clause:
    clause = _Clause(text=" ".join(tokens))
    tokens, clause.without = _without(_without_negated_colour(tokens))
    if not tokens:  # "but not the wheels"
        return clause
    if "or" in tokens:
        clause.action = "other"
        clause.unread = ("or",)
        return clause
    unsupported = tokens[0] in words.OTHER and not _repaints(tokens)
    negated = [token for token in tokens if token in words.NEGATIONS]
    if unsupported or negated:
        clause.action = "other"
        clause.unread = tuple(negated or tokens[:1])
        return clause
    removing = [i for i, token in enumerate(tokens) if token in words.REMOVE]
    if removing and set(tokens[: removing[0]]) <= words.FILLERS | words.POLITENESS:
        clause.action = "remove"
        clause.verb_first = True
        clause.thing = read_thing(tokens[removing[0] + 1 :])
        return clause
    return _read_change(tokens, clause)


def _without_negated_colour(tokens: list[str]) -> list[str]:
    """The clause without "not red", as in "not red but green"."""
    for start, token in enumerate(tokens[:-1]):
        found = words.read_colour(tokens[start + 1 :])
        if token == "not" and found is not None:
            return tokens[:start] + tokens[start + 1 + found[1] :]
    return tokens


def _without(tokens: list[str]) -> tuple[list[str], list[Thing]]:
    """The clause without "except the bear", and the bear.

    The exception ends where the change begins: "everything except the bear red".
    """
    for marker in ("except", "without"):
        if marker not in tokens[1:]:
            continue
        start = tokens.index(marker, 1)
        rest = tokens[start + 1 :]
        if rest and rest[0] in words.TOUCH:
            rest = rest[1:]
        changes = _last_group(_changes(rest), rest) if rest else []
        ends = bool(changes) and changes[-1].end == len(rest)
        end = changes[0].start if ends and changes[0].start > 0 else len(rest)
        if not [t for t in rest[:end] if t not in words.FILLERS]:
            continue
        return tokens[:start] + rest[end:], [read_thing(rest[:end])]
    return tokens, []


def _repaints(tokens: list[str]) -> bool:
    """Whether "replace red with green", or "give the wall a blue colour", is about colours."""
    if tokens[0] in ("replace", "swap"):
        middle = next(
            (i for i, t in enumerate(tokens) if t in ("with", "by", "for")), 0
        )
        before = [t for t in tokens[1:middle] if t not in words.DETERMINERS]
        return bool(words.read_colour(before)) and bool(_changes(tokens[middle:]))
    if tokens[0] in ("give", "draw"):
        return bool(_changes(tokens)) or _look(tokens) is not None
    return False


def _read_change(tokens: list[str], clause: _Clause) -> _Clause:
    """A clause that changes colours, gives a look, or only names a thing."""
    told = _as_told(tokens)
    tokens, origin = _origin(told)
    if not tokens:  # "from red" names neither a thing nor what it shall become
        clause.action, clause.unread = "other", tuple(told)
        return clause
    look = _look(tokens)
    if look is not None:
        clause.action = "look"
        clause.look, before = look
        clause.thing = read_thing(before)
        if _changes(before):  # "brown like in autumn"
            clause.action = "other"
            clause.unread = (clause.look,)
        return clause
    changes = _changes(tokens)
    if not changes:
        return _only_names(tokens, clause, origin)
    group = _last_group(changes, tokens)
    start, end = group[0].start, group[-1].end
    before, after = tokens[:start], tokens[end:]
    clause.action = "paint"
    clause.verb_first = tokens[start] in words.IMPERATIVES | words.RANDOM
    amount = _amount(tokens)
    clause.changes = tuple(_scaled(found.change, amount) for found in group)
    named, other = (before, after) if _content(before) else (after, [])
    if not _content(before) and _content(after) and not _may_follow(group[-1], tokens):
        named, other = [], after
    unread = [t for t in _content(other) if t not in words.PARTS]
    if set(unread) <= words.PLACES:  # "paint the vase red on the left"
        named = [*unread, *named]
        unread = []
    unread += [t for t in named if t in words.MORE | words.LESS | words.UNSUPPORTED]
    clause.unread = tuple(unread)
    clause.thing = _painted_thing(named, origin)
    if set(tokens) & words.FLOOD and clause.thing.scope in ("named", "marked"):
        which = dict.fromkeys(("whole", *clause.thing.which))
        clause.thing = replace(clause.thing, which=tuple(which))
    if clause.unread:
        clause.action = "other"
    return clause


def _amount(tokens: list[str]) -> float:
    """How strong the change shall be, 1 as named."""
    if set(tokens) & words.WEAK:
        return 0.5
    return 1.7 if set(tokens) & words.STRONG else 1.0


def _as_told(tokens: list[str]) -> list[str]:
    """Read the purple door of "I want a purple door" as "door purple"."""
    paint = words.read_paint(tokens[1:]) if tokens[0] == "turned" else None
    if paint is None:
        return tokens
    _, length = paint
    thing = tokens[1 + length :]
    plain = bool(_content(thing)) and not _changes(thing) and _look(thing) is None
    return [*thing, *tokens[1 : 1 + length]] if plain else tokens


def _only_names(tokens: list[str], clause: _Clause, origin: Colour | None) -> _Clause:
    """A clause without a change: a thing that shares a neighbour's, or something unknown."""
    says_more = set(tokens) & (words.MORE | words.LESS | words.NEGATIONS)
    content = _content(tokens)
    if clause.without and read_thing(tokens).scope == "whole":  # the change follows
        clause.thing = read_thing(tokens)
        return clause
    begins = tokens[0] in words.PAINT | words.DETERMINERS or len(content) == 1
    if says_more or origin is not None or not content or not begins:
        clause.action = "other"
        clause.unread = tuple(t for t in content if t not in words.PRONOUNS) or tuple(
            tokens
        )
        return clause
    clause.thing = read_thing(tokens)
    return clause


def _origin(tokens: list[str]) -> tuple[list[str], Colour | None]:
    """Take "from COLOUR" or "instead of COLOUR" out of a clause."""
    for start, token in enumerate(tokens):
        if token not in ("from", "insteadof"):
            continue
        found = words.read_colour(tokens[start + 1 :])
        if found is not None:
            colour, length = found
            return tokens[:start] + tokens[start + 1 + length :], colour
    return tokens, None


def _look(tokens: list[str]) -> tuple[str, list[str]] | None:
    """The look that a clause asks for, and the words before it, which name the thing."""
    if "same" in tokens:  # "the same colour as the table"
        return None
    for start, token in enumerate(tokens):
        skipped = words.FILLERS | words.PRONOUNS | {"it's"}
        rest = [t for t in tokens[start + 1 :] if t not in skipped]
        if token in words.STYLE and rest and not _changes(rest):
            return " ".join(rest), tokens[:start]
        if token in words.LOOKS and _ends_with_look(tokens[start + 1 :]):
            return token, tokens[:start]
    return None


def _ends_with_look(after: list[str]) -> bool:
    """Whether only nouns for a style follow; "of the street" says what the photo shows."""
    if "of" in after:
        after = after[: after.index("of")]
    return set(after) <= words.STYLE_NOUNS | words.LOOKS | words.POLITENESS


# ---- changes ----


@dataclass(frozen=True)
class _Found:
    """A change found at tokens[start:end]."""

    start: int
    end: int
    change: Change


def _changes(tokens: list[str]) -> list[_Found]:
    found: list[_Found] = []
    index = 0
    while index < len(tokens):
        change = _change_at(tokens, index)
        if change is not None:
            found.append(change)
            index = change.end
        else:
            index += 1
    return found


def _change_at(tokens: list[str], start: int) -> _Found | None:
    rest = tokens[start:]
    first = rest[0]
    if first in words.MORE | words.LESS:
        return _more_or_less(rest, start)
    paint = _paint_at(tokens, start)
    if paint is not None:
        return paint
    if first in words.TINTS:
        return _Found(start, start + 1, _tint(words.TINTS[first]))
    if first in words.ADJUSTMENTS:
        return _Found(start, start + 1, words.ADJUSTMENTS[first])
    if first in words.RANDOM:
        return _Found(start, start + 1, Change("random"))
    return None


def _paint_at(tokens: list[str], start: int) -> _Found | None:
    before, rest = tokens[:start], tokens[start:]
    if rest[0] == "snow" and not set(before[-1:]) & {"of", "into", "to", "like", "in"}:
        return None  # "make it snow"
    found = words.read_paint(rest)
    if found is None:
        return None
    change, length = found
    shorter = words.read_paint(rest[1:]) if length > 1 else None
    if shorter is not None and before[-1:] == ["the"] and rest[0] not in words.TONES:
        return None  # "the sea green" is a green sea
    if set(rest[length : length + 1]) & words.PARTS:
        return None  # "the red parts" are a thing
    return _Found(start, start + length, change)


def _tint(name: str) -> Change:
    found = words.read_colour([name])
    assert found is not None  # every word of TINTS is a colour
    return Change("tint", found[0], amount=words.TINT_SHARE)


def _more_or_less(rest: list[str], start: int) -> _Found | None:
    """Read "more saturated", "increase the brightness", "less contrast", "more blue"."""
    sign = 1.0 if rest[0] in words.MORE else -1.0
    skipped = 2 if rest[1:2] == ["the"] else 1
    word = rest[skipped] if len(rest) > skipped else ""
    end = start + skipped + 1
    if word in words.PROPERTIES:
        return _Found(start, end, Change(words.PROPERTIES[word], amount=sign))
    if word in words.ADJUSTMENTS:
        known = words.ADJUSTMENTS[word]
        return _Found(start, end, replace(known, amount=sign * known.amount))
    if rest[0] == "more" and word in words.BASIC_COLOURS:  # "more snow" is no colour
        return _Found(start, end, _tint(word))
    return None


def _last_group(changes: list[_Found], tokens: list[str]) -> list[_Found]:
    """The last changes with nothing but degree words between them.

    Earlier ones describe the thing: "make the red bike blue".
    """
    if not changes:
        return []
    group = [changes[-1]]
    for change in reversed(changes[:-1]):
        between = tokens[change.end : group[0].start]
        kinds = [found.change.kind for found in group]
        two_paints = change.change.kind == "paint" and "paint" in kinds
        if tokens[change.start] in words.NICE and tokens[: change.start][-1:] in (
            ["a"],
            ["nice"],
        ):
            continue  # "a nice warm yellow"
        if two_paints or not set(between) <= words.WEAK | words.STRONG | {"a"}:
            break
        group.insert(0, change)
    return group


def _scaled(change: Change, amount: float) -> Change:
    if change.kind == "paint":
        return change
    scaled = change.amount * amount
    return replace(change, amount=min(1.0, scaled) if change.kind == "tint" else scaled)


def _content(tokens: list[str]) -> list[str]:
    """The words that are neither fillers nor degrees."""
    ignored = (
        words.FILLERS
        | words.WEAK
        | words.STRONG
        | words.RANDOM
        | words.PAINT
        | words.NICE
    )
    return [
        t for t in tokens if t not in ignored or t in words.PRONOUNS - {"that", "this"}
    ]


def _may_follow(change: _Found, tokens: list[str]) -> bool:
    """Whether the thing may follow: "darken walls", "more contrast in the sky", "paint red the
    bike".
    """
    after = tokens[change.end :]
    first = tokens[change.start]
    if first in words.IMPERATIVES | words.RANDOM or first in words.TINTS:
        return True
    if first in words.ADJUSTMENTS and first.endswith("er"):  # "a darker sky"
        return True
    return after[0] in words.DETERMINERS or (
        after[0] in ("in", "on", "for") and len(after) > 1
    )


def _painted_thing(named: list[str], origin: Colour | None) -> Thing:
    """The thing of a change. "Turn red into blue" is about what is red."""
    content = [t for t in named if t not in words.FILLERS | words.PAINT]
    colour = words.read_colour(content)
    determined = bool(set(named) & {"the", "a", "an", "my"})
    if (
        origin is None
        and colour is not None
        and colour[1] == len(content)
        and not determined
    ):
        return Thing("whole", part=colour[0])
    thing = read_thing(named)
    if origin is None:
        return thing
    scope = "whole" if thing.scope == "marked" and not thing.name else thing.scope
    return replace(thing, scope=scope, part=origin)


# ---- clauses together ----


def _shared(clauses: list[_Clause]) -> list[_Clause]:
    """Give clauses that only name things the change of their neighbours.

    That of the next clause, as in "paint the door and the wall white"; where none follows, or the
    change stands first ("darken the door and the wall"), that of the clause before.
    """
    filled: list[_Clause] = []
    for index, clause in enumerate(clauses):
        follower = clauses[index + 1] if index + 1 < len(clauses) else None
        if (
            not clause.action
            and clause.without
            and follower
            and follower.action == "paint"
        ):
            # "everything but the sky and the water red"
            kept_too = [follower.thing] if follower.thing is not None else []
            follower.without = [*clause.without, *kept_too]
            follower.thing = clause.thing
            continue
        if clause.action:
            filled.append(clause)
            continue
        before = next((c for c in reversed(clauses[:index]) if c.action), None)
        after = next((c for c in clauses[index:] if c.action), None)
        giver = before if before is not None and before.verb_first else after
        if giver is None or giver.action == "other":
            unread = tuple(_content(clause.text.split()))
            filled.append(replace(clause, action="other", unread=unread))
            continue
        shared = {name: getattr(giver, name) for name in ("action", "changes", "look")}
        thing = clause.thing or Thing()
        if giver.thing is not None:
            part = thing.part or giver.thing.part
            thing = replace(thing, part=part, name=thing.name or giver.thing.name)
        filled.append(replace(clause, **shared, thing=thing))
    return filled


def _resolved(clauses: list[_Clause], kept: list[Thing]) -> Iterator[Wish]:
    """The clauses as wishes, with pronouns resolved and what is kept left out of the thing."""
    last: Thing | None = None
    for clause in clauses:
        thing = clause.thing or Thing()
        if (
            thing.scope == "named" and not thing.name and last is not None
        ):  # "the blue one"
            thing = replace(thing, name=last.name)
        kept = [replace(one, name=one.name or thing.name) for one in kept]
        only_adjusts = all(
            change.kind not in ("paint", "random") for change in clause.changes
        )
        without = [*clause.without, *(one for one in kept if _matters(one, thing))]
        if thing.scope == "marked" and not thing.part:
            named = thing.name == "it"
            if last is not None:
                thing = last
            elif (
                without or clause.action == "look" or (only_adjusts and clause.changes)
            ):
                thing = Thing("marked" if named and without else "whole")
        if thing.name == "it":
            thing = replace(thing, name="")
        if thing.scope != "whole" or last is None:
            last = thing
        yield Wish(
            action=clause.action or "other",
            thing=thing,
            changes=clause.changes if clause.action == "paint" else (),
            look=clause.look if clause.action == "look" else "",
            without=tuple(dict.fromkeys(without)),
            text=clause.text,
            unread=clause.unread,
        )


def _matters(kept: Thing, thing: Thing) -> bool:
    """Whether keeping `kept` says anything about a wish on `thing`: a bike has no background."""
    return kept.scope != "background" or thing.scope == "whole"


def _merged(wishes: Iterator[Wish], prompt: str) -> list[Wish]:
    """Wishes of one action about one thing become one; painting comes before adjusting."""
    merged: dict[tuple, Wish] = {}
    for number, wish in enumerate(wishes):
        alone = number if wish.action == "other" else -1
        key = (alone, wish.action, wish.thing, wish.without, wish.look)
        if key not in merged:
            merged[key] = wish
            continue
        first = merged[key]
        changes = sorted(
            (*first.changes, *wish.changes), key=lambda one: one.kind != "paint"
        )
        text = f"{first.text}, {wish.text}"
        merged[key] = replace(first, changes=tuple(dict.fromkeys(changes)), text=text)
    for wish in merged.values():
        if sum(change.kind == "paint" for change in wish.changes) > 1:
            raise PromptError(
                f"{prompt!r} asks for two colours at once; name one, or what else gets the other."
            )
    return list(merged.values())


def _with_rest(wishes: list[Wish]) -> Iterator[Wish]:
    """In "the car blue and the background grey" the background is all but the car."""
    named = [wish.thing for wish in wishes if wish.thing.scope in ("named", "marked")]
    for wish in wishes:
        if wish.thing.scope != "background" or not named or wish.without:
            yield wish
        else:
            yield replace(wish, without=tuple(dict.fromkeys(named)))
