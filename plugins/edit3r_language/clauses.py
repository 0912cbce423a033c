"""What one clause of a sentence says: what to do, and with which thing."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

from edit3r.contract.instructions import FLOOD, Action, Change, Colour, Target
from edit3r.kit.compute.colour_names import read_colour
from edit3r_language.changes import (
    ChangeSpan,
    amount_of,
    find_changes,
    is_percentage,
    last_group,
    scaled,
)
from edit3r_language.known_words import is_known, is_noun, unknown_words, unread_of
from edit3r_language.paints import read_paint
from edit3r_language.places import read_region, unclear_place
from edit3r_language.shades import read_taken
from edit3r_language.targets import read_target
from edit3r_language.vocabulary import ADJUSTMENTS, TINTS, WORDS


@dataclass
class Clause:
    """What one clause says; parts that it leaves open are filled in from its neighbours."""

    text: str
    action: Action | None = None  # None where the clause only names things
    target: Target | None = None
    changes: tuple[Change, ...] = ()
    look: str = ""
    without: list[Target] = field(default_factory=list)
    unread: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    verb_first: bool = False  # "remove the bin": things may follow in the next clauses

    def not_understood(self, *unread: str) -> "Clause":
        """The clause as an instruction that nobody here understands."""
        return replace(self, action="other", unread=unread)


def asks_nothing(tokens: list[str]) -> bool:
    """Politeness, or "not blue" and "not brighter" beside another change."""
    if set(tokens) <= WORDS.politeness | WORDS.nothing:
        return True
    if tokens[0] not in WORDS.negations or len(tokens) == 1:
        return False
    adjusts = set(tokens[1:]) <= ADJUSTMENTS.keys()
    return adjusts or read_colour(tokens[1:]) is not None


def read_kept(tokens: list[str]) -> list[Target] | None:
    """The things that a clause wants left as they are; None for a clause of another kind."""
    staying = next((i for i, token in enumerate(tokens) if token in WORDS.stays), 0)
    if staying:  # "the tank stays red"
        tokens = ["keep", *tokens[:staying]]
    keeps = tokens[0] in WORDS.keep
    negates = tokens[0] in WORDS.negations
    if negates and len(tokens) > 1 and tokens[1] in WORDS.touch:
        tokens = tokens[1:]
    elif not keeps and not negates:
        return None
    content = [t for t in tokens[1:] if t not in WORDS.fillers | WORDS.as_it_is]
    if set(content) <= WORDS.kept_anyway - WORDS.background:
        return []
    if keeps and tokens[-1] in ADJUSTMENTS | TINTS.keys():
        return None
    if negates and find_changes(tokens):  # "don't paint the bike red"
        return None
    return [read_target(_without_own_colour(tokens[1:]))]


def _without_own_colour(tokens: list[str]) -> list[str]:
    """The words of what is kept, without what it stays: "the bus" of "keep the bus red"."""
    tokens = [t for t in tokens if t not in WORDS.as_it_is]
    for start in range(1, len(tokens)):
        found = read_colour(tokens[start:])
        named = content_of(tokens[:start])
        if found is not None and named and found[1] == len(tokens) - start:
            return tokens[:start] if not is_noun(tokens[-1]) else tokens
    return tokens


def read_clause(tokens: list[str]) -> Clause:
    """What a clause says that keeps nothing as it is."""
    shares = tuple(filter(is_percentage, tokens))
    plain = [token for token in tokens if token not in shares]
    clause = _read_plain(plain, Clause(text=" ".join(tokens)))
    kinds = {change.kind for change in clause.changes}
    nothing = any(int(share[:-1]) <= 0 for share in shares)  # "-20% darker"
    if shares and (nothing or not kinds or "paint" in kinds):  # "30% red"
        return clause.not_understood(*dict.fromkeys((*shares, *clause.unread)))
    return clause


def _read_plain(tokens: list[str], clause: Clause) -> Clause:
    """The clause by its words without percentages; how strong a change is, its text says."""
    for marker, place in pairwise(tokens):  # "except behind the bed"
        if marker in ("except", "without") and place in WORDS.standing:
            return clause.not_understood(place)
    tokens, clause.without = _without(_without_negated_colour(tokens))
    if not tokens:  # "but not the wheels"
        return clause
    unsupported = _unsupported(tokens)
    if unsupported:
        return clause.not_understood(*unsupported)
    verbs = WORDS.remove | WORDS.hide
    acting = [i for i, token in enumerate(tokens) if token in verbs]
    if acting and set(tokens[: acting[0]]) <= WORDS.fillers | WORDS.politeness:
        return _read_verb(tokens[acting[0]], tokens[acting[0] + 1 :], clause)
    return _read_change(tokens, clause)


def _read_verb(verb: str, named: list[str], clause: Clause) -> Clause:
    """A clause that takes a thing away, or hides it; its words stand after the verb."""
    clause.action, clause.verb_first = "remove", True
    if verb in WORDS.hide:
        clause.action, clause.look = "look", verb
    clause.target = read_target(named)
    unclear = unclear_place(named)
    if clause.target.part is not None and "some" in named:  # "some of the red"
        unclear += ("some",)
    if clause.target.scope != "region":
        unclear += tuple(t for t in named if t in WORDS.ordinals)
    return clause.not_understood(*dict.fromkeys(unclear)) if unclear else clause


def content_of(tokens: list[str]) -> list[str]:
    """The words that are neither fillers nor degrees."""
    ignored = WORDS.fillers | WORDS.weak | WORDS.strong | WORDS.random
    ignored |= WORDS.paint | WORDS.nice
    pronouns = WORDS.pronouns - {"that", "this"}
    return [t for t in tokens if t not in ignored or t in pronouns]


def blamed(tokens: list[str]) -> tuple[str, ...]:
    """Which words of a clause that asks for nothing known are to blame.

    "nice" of "make it nice"; none of "paint the wall", which does not say in which colour.
    """
    nice = tuple(token for token in tokens if token in WORDS.nice)
    content = [token for token in content_of(tokens) if token not in WORDS.pronouns]
    # "the wall", not "it rain"
    named = not content or bool(set(tokens) & (WORDS.determiners - WORDS.pronouns))
    named = named and all(map(is_noun, content))
    return nice or (() if named else unread_of(content))


# ---- what is left out of the thing ----


def _without_negated_colour(tokens: list[str]) -> list[str]:
    """The clause without "not red", as in "not red but green"."""
    for start, token in enumerate(tokens[:-1]):
        found = read_colour(tokens[start + 1 :])
        if token == "not" and found is not None:
            return tokens[:start] + tokens[start + 1 + found[1] :]
    return tokens


def _without(tokens: list[str]) -> tuple[list[str], list[Target]]:
    """The clause without "except the bear", and the bear.

    The exception ends where the change begins: "everything except the bear red".
    """
    for marker in ("except", "without"):
        if marker not in tokens[1:]:
            continue
        start = tokens.index(marker, 1)
        rest = tokens[start + 1 :]
        if rest and rest[0] in WORDS.touch:
            rest = rest[1:]
        end = _end_of_exception(rest, tokens)
        if not [t for t in rest[:end] if t not in WORDS.fillers]:
            continue
        return tokens[:start] + rest[end:], [read_target(rest[:end])]
    return tokens, []


def _end_of_exception(rest: list[str], tokens: list[str]) -> int:
    """Where the change begins that follows an exception; after a verb none does."""
    look = _look(rest)
    if look is not None and look[1]:  # "everything but the tram a vintage look"
        return len(look[1])
    changes = last_group(find_changes(rest), rest) if rest else []
    ends = bool(changes) and changes[-1].end == len(rest)
    removes = bool(set(tokens[:2]) & WORDS.remove)
    follows = ends and changes[0].start > 0 and not removes
    return changes[0].start if follows else len(rest)


# ---- what nobody understands ----


def _unsupported(tokens: list[str]) -> tuple[str, ...]:
    """The words of a clause that say at once that nobody here can carry it out."""
    if "or" in tokens:
        return ("or",)
    pairs = tuple(t for t in tokens if "/" in t and read_colour([t]) is None)
    if pairs:  # "red/blue" is one of them, or both
        return pairs
    negated = tuple(token for token in tokens if token in WORDS.negations)
    if negated:
        return negated
    asks = tokens[0] in WORDS.questions
    other = tokens[0] in WORDS.other and not _repaints(tokens)
    return (tokens[0],) if asks or other else ()


def _repaints(tokens: list[str]) -> bool:
    """Whether "replace red with green", or "give the wall a blue colour", is about colours."""
    if tokens[0] in ("replace", "swap"):
        joins = [i for i, t in enumerate(tokens) if t in ("with", "by", "for")]
        middle = joins[0] if joins else 0
        before = [t for t in tokens[1:middle] if t not in WORDS.determiners]
        return bool(read_colour(before)) and bool(find_changes(tokens[middle:]))
    if tokens[0] in ("give", "draw"):
        return bool(find_changes(tokens)) or _look(tokens) is not None
    return False


# ---- changes of colour and looks ----


def _read_change(tokens: list[str], clause: Clause) -> Clause:
    """A clause that changes colours, gives a look, or only names a thing."""
    ordered = _target_first(tokens)
    tokens, origin = _origin(ordered)
    if not tokens:  # "from red" names neither a thing nor what it shall become
        return clause.not_understood(*ordered)
    look = _look(tokens)
    if look is not None:
        return _read_look(*look, clause)
    changes = find_changes(tokens)
    if not changes:
        return _only_names(tokens, clause, origin)
    group = last_group(changes, tokens)
    degrees = [*tokens, *filter(is_percentage, clause.text.split())]
    clause.action = "paint"
    clause.verb_first = tokens[group[0].start] in WORDS.imperatives | WORDS.random
    wanted = [found.change for found in group]
    clause.changes = tuple(scaled(one, amount_of(one, degrees)) for one in wanted)
    clause.left_out = tuple(word for found in group for word in found.left_out)
    named, unread = _split_around(tokens, group)
    clause.target = _flooded(_painted_target(named, origin), tokens)
    return clause.not_understood(*unread) if unread else clause


def _split_around(
    tokens: list[str], group: list[ChangeSpan]
) -> tuple[list[str], tuple[str, ...]]:
    """The words that name what is changed, and those that nobody understands."""
    before, after = tokens[: group[0].start], tokens[group[-1].end :]
    named, other = (before, after) if content_of(before) else (after, [])
    in_front = not content_of(before) and bool(content_of(after))
    if in_front and not _may_follow(group[-1], tokens):
        named, other = [], after
    unread = [
        t for t in content_of(other) if t not in WORDS.parts | FLOOD | WORDS.picture
    ]
    unread = list(unread_of(unread))
    if set(unread) <= WORDS.places:  # "paint the vase red on the left"
        named, unread = [*unread, *named], []
    if read_region(named) is None:  # "the lower half"
        unread += [t for t in named if t in WORDS.more | WORDS.less | WORDS.unsupported]
    unread += unclear_place(named)
    unread += unknown_words(named, before_change=named == before and bool(before))
    colour = read_colour(named)
    joined = set(tokens) & (WORDS.fillers | WORDS.paint)
    if colour is not None and colour[1] == len(named) and not joined:  # "red blue"
        unread += tokens
    return named, tuple(dict.fromkeys(unread))


def _flooded(target: Target, tokens: list[str]) -> Target:
    """All of a thing, its neutral parts too, where the clause says so."""
    if not set(tokens) & FLOOD or target.scope not in ("named", "marked"):
        return target
    return replace(
        target, qualifiers=tuple(dict.fromkeys(("whole", *target.qualifiers)))
    )


def _target_first(tokens: list[str]) -> list[str]:
    """Read the purple door of "I want a purple door" as "door purple"; so "purple door"."""
    paint = None
    if tokens[0] == "turned":
        paint = read_paint(tokens[1:])
        tokens = tokens[1:] if paint is not None else tokens
    elif is_noun(tokens[-1]):
        paint = read_paint(tokens)
    if paint is None:
        return tokens
    target = tokens[paint.length :]
    plain = bool(content_of(target)) and not find_changes(target) and not _look(target)
    all_known = not set(target) & WORDS.fillers
    return ["the", *target, *tokens[: paint.length]] if plain and all_known else tokens


def _only_names(tokens: list[str], clause: Clause, origin: Colour | None) -> Clause:
    """A clause without a change: a thing that shares a neighbour's, or something unknown."""
    says_more = set(tokens) & (WORDS.more | WORDS.less | WORDS.negations)
    content = content_of(tokens)
    follows = clause.without and read_target(tokens).scope == "whole"  # a change
    begins = (
        follows or tokens[0] in WORDS.paint | WORDS.determiners or len(content) == 1
    )
    unclear = unclear_place(tokens)
    if read_region(tokens) is None and (
        says_more or origin is not None or not content or not begins or unclear
    ):
        return clause.not_understood(*(unclear or blamed(tokens)))
    clause.target = read_target(tokens)
    return clause


def _origin(tokens: list[str]) -> tuple[list[str], Colour | None]:
    """Take "from COLOUR" or "instead of COLOUR" out of a clause."""
    for start, token in enumerate(tokens):
        if token not in ("from", "insteadof"):
            continue
        found = read_colour(tokens[start + 1 :])
        if found is not None:
            colour, length = found
            return tokens[:start] + tokens[start + 1 + length :], colour
    return tokens, None


def _painted_target(named: list[str], origin: Colour | None) -> Target:
    """The thing of a change. "Turn red into blue" is about what is red."""
    target = read_target(named)
    if origin is None:
        return target
    scope = "whole" if target.scope == "marked" and not target.name else target.scope
    return replace(target, scope=scope, part=origin)


def _may_follow(change: ChangeSpan, tokens: list[str]) -> bool:
    """Whether the thing may follow: "darken walls", "more contrast in the sky"."""
    after = [t for t in tokens[change.end :] if t not in WORDS.paint]
    first = tokens[change.start]
    if first in WORDS.imperatives | WORDS.random or first in TINTS:
        return True
    if first in ADJUSTMENTS and first.endswith("er"):  # "a darker sky"
        return True
    joined = after[0] in ("in", "on", "for", "of") and len(after) > 1
    return joined or after[0] in WORDS.determiners


def _read_look(look: str, before: list[str], clause: Clause) -> Clause:
    """A clause that gives a look to what stands before its word."""
    if find_changes(before):  # "brown like in autumn"
        return clause.not_understood(look)
    before = [token for token in before if token != "turned"]
    if not set(before) & WORDS.determiners:  # "spooky night"
        unread = [t for t in content_of(before) if not is_known(t)]
        if unread:
            return clause.not_understood(*unread)
    clause.left_out = tuple(w for w in look.split() if w in WORDS.not_drawn)
    look = " ".join(w for w in look.split() if w not in WORDS.not_drawn)
    clause.action, clause.look, clause.target = "look", look, read_target(before)
    return clause


def _look(tokens: list[str]) -> tuple[str, list[str]] | None:
    """The look that a clause asks for, and the words before it, which name the thing."""
    if "same" in tokens or read_taken(tokens) is not None:  # "as white as the table"
        return None
    for start, token in enumerate(tokens):
        skipped = WORDS.fillers | WORDS.pronouns | {"it's"}
        rest = [t for t in tokens[start + 1 :] if t not in skipped]
        if token in WORDS.style and rest and not find_changes(rest):
            return " ".join(rest), tokens[:start]
        if token in WORDS.looks and _ends_with_look(tokens[start + 1 :]):
            return token, tokens[:start]
    return None


def _ends_with_look(after: list[str]) -> bool:
    """Whether only nouns for a style follow; "of the street" says what the photo shows."""
    if "of" in after:
        after = after[: after.index("of")]
    return set(after) <= WORDS.style_nouns | WORDS.looks | WORDS.politeness
