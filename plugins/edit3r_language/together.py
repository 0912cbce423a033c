"""Clauses put together: changes that several things share, pronouns, and what is kept."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import EVERY, Instruction, Thing
from edit3r_language.clauses import Clause, blamed
from edit3r_language.nouns import is_plural
from edit3r_language.things import read_thing
from edit3r_language.vocabulary import WORDS


def instructions_of(
    clauses: list[Clause], kept: list[Thing], prompt: str
) -> tuple[Instruction, ...]:
    """The instructions of a sentence's clauses. Raises PromptError for what contradicts itself."""
    return merged(_resolved(_shared(clauses), kept), prompt)


def merged(instructions: Iterable[Instruction], prompt: str) -> tuple[Instruction, ...]:
    """The instructions, one for each thing. Raises PromptError for what contradicts itself."""
    return tuple(_with_rest(_merged(instructions, prompt)))


# ---- what neighbours share ----


def _shared(clauses: list[Clause]) -> list[Clause]:
    """Give clauses that only name things the change of their neighbours."""
    filled: list[Clause] = []
    for index, clause in enumerate(clauses):
        if _goes_on(clause, clauses[index + 1 :]):
            continue
        giver = None if clause.action else _giver(clauses, index)
        if clause.action:
            filled.append(clause)
        elif giver is None or giver.action == "other":
            filled.append(clause.not_understood(*blamed(clause.text.split())))
        else:
            filled.append(_with_change_of(clause, giver))
    return filled


def _goes_on(clause: Clause, following: list[Clause]) -> bool:
    """Whether an exception goes on in the next clause, which then has all of it.

    "everything but the sky and the water red".
    """
    if clause.action or not clause.without or not following:
        return False
    follower = following[0]
    if follower.action != "paint":
        return False
    kept_too = [follower.thing] if follower.thing is not None else []
    follower.without = [*clause.without, *kept_too]
    follower.thing = clause.thing
    return True


def _giver(clauses: list[Clause], index: int) -> Clause | None:
    """The clause whose change one without any shares.

    The next one, as in "paint the door and the wall white"; where none follows, or the change
    stands first ("darken the door and the wall"), the one before.
    """
    before = next((c for c in reversed(clauses[:index]) if c.action), None)
    after = next((c for c in clauses[index:] if c.action), None)
    return before if before is not None and before.verb_first else after


def _with_change_of(clause: Clause, giver: Clause) -> Clause:
    thing = clause.thing or Thing()
    if giver.thing is not None and thing.scope != "region":
        part = thing.part or giver.thing.part
        thing = replace(thing, part=part, name=thing.name or giver.thing.name)
    return replace(
        clause,
        action=giver.action,
        changes=giver.changes,
        look=giver.look,
        left_out=giver.left_out,
        thing=thing,
    )


# ---- pronouns, and what is kept ----


def _resolved(clauses: list[Clause], kept: list[Thing]) -> Iterator[Instruction]:
    """The clauses as instructions, pronouns resolved, and what is kept left out of the thing."""
    last: Thing | None = None
    said: list[str] = []  # the words that named it
    for clause in clauses:
        thing = clause.thing or Thing()
        if thing.scope == "named" and not thing.name and last is not None:
            thing = replace(thing, name=last.name)  # "the blue one"
        if thing.of == "it" and last is not None:  # "its wheels"
            thing = replace(thing, of=_owner(last, said))
        if thing.scope == "region" and last is not None:
            thing = _other_side(thing, clause, last)
        kept = [_named_like(one, thing) for one in kept]
        own = [_named_like(one, thing) for one in clause.without]
        if thing.scope == "background" and thing.of:  # "the background of the fox"
            own, thing = [*own, read_thing(thing.of.split())], replace(thing, of="")
        without = [*own, *(one for one in kept if _matters(one, thing))]
        thing = _pointed_at(thing, last, clause, without)
        if thing.scope != "whole" or last is None:
            last, said = thing, clause.text.split()
        yield _instruction(clause, _all_of_name(thing, without), without)


def _owner(last: Thing, said: Sequence[str]) -> str:
    """What "its" stands for: after "the house's door" it is the house, after "the cup" the cup."""
    whole = last.of.split()[-1:]
    belongs = "of" in said or any(f"{word}'s" in said for word in whole)
    return last.of if whole and belongs else last.name


def _other_side(region: Thing, clause: Clause, last: Thing) -> Thing:
    """ "The lower part" after "the upper part of the statue": the statue's, not the picture's."""
    sides = [word for word in clause.text.split() if word in WORDS.places]
    if not last.of or last.name not in WORDS.places or not sides:
        return region
    return Thing("named", " ".join(sides), of=last.of)


def _named_like(kept: Thing, thing: Thing) -> Thing:
    """ "The middle one", which is kept of the cups, by its name."""
    if kept.name or kept.scope != "named":
        return kept
    return replace(kept, name=thing.name)


def _matters(kept: Thing, thing: Thing) -> bool:
    """Whether keeping `kept` matters to an instruction on `thing`: a bike has no background."""
    return kept.scope != "background" or thing.scope == "whole"


def _pointed_at(
    thing: Thing, last: Thing | None, clause: Clause, without: Sequence[Thing]
) -> Thing:
    """What "it" or no name at all stands for.

    What was named last in the sentence. Without any, looks and adjustments are about the whole; its
    name stays "it" where the sentence says so, since an earlier run may have named something.
    """
    if thing.scope != "marked" or thing.part is not None:
        return thing
    if last is not None:
        return last
    kinds = {change.kind for change in clause.changes}
    adjusts = bool(kinds) and not kinds & {"paint", "random"}
    said = thing.name == "it"
    if without:
        return Thing("marked" if said else "whole")
    if clause.action == "look" or adjusts:
        return Thing("whole", "it" if said and not thing.which else "")
    return replace(thing, name="") if said else thing


def _all_of_name(thing: Thing, without: Sequence[Thing]) -> Thing:
    """All of the cups, where one of them is left out: "the cups but the middle one"."""
    one_of_them = any(kept.name == thing.name and kept.which for kept in without)
    several = is_plural(thing.name.split()[-1]) if thing.name else False
    if not one_of_them or not several or set(thing.which) & EVERY:
        return thing
    return replace(thing, which=("all", *thing.which))


def _instruction(clause: Clause, thing: Thing, without: Sequence[Thing]) -> Instruction:
    return Instruction(
        action=clause.action or "other",
        thing=thing,
        changes=clause.changes if clause.action == "paint" else (),
        look=clause.look if clause.action == "look" else "",
        without=tuple(dict.fromkeys(without)),
        text=clause.text,
        unread=clause.unread,
        left_out=clause.left_out,
    )


# ---- instructions about one thing ----


def _merged(instructions: Iterable[Instruction], prompt: str) -> list[Instruction]:
    """Instructions of one action about one thing become one; painting comes before adjusting.

    Raises PromptError for two colours, and for more and less of one thing.
    """
    merged: dict[tuple, Instruction] = {}
    for number, instruction in enumerate(instructions):
        alone = number if instruction.action == "other" else -1
        about = instruction.thing, instruction.without, instruction.look
        key = alone, instruction.action, about
        before = merged.get(key)
        merged[key] = _joined(before, instruction) if before else instruction
    for instruction in merged.values():
        kinds = [change.kind for change in instruction.changes]
        if kinds.count("paint") > 1:
            raise PromptError(
                f"{prompt!r} asks for two colours at once; name one, or what else gets the other."
            )
        for kind in kinds:
            amounts = [one.amount for one in instruction.changes if one.kind == kind]
            if min(amounts) < 0 < max(amounts):
                raise PromptError(
                    f"{prompt!r} asks for more {kind} and for less; ask for one of them."
                )
    return list(merged.values())


def _joined(first: Instruction, second: Instruction) -> Instruction:
    changes = [*first.changes, *second.changes]
    changes.sort(key=lambda one: one.kind != "paint")
    return replace(
        first,
        changes=tuple(dict.fromkeys(changes)),
        text=f"{first.text}, {second.text}",
        left_out=tuple(dict.fromkeys((*first.left_out, *second.left_out))),
    )


def _with_rest(instructions: list[Instruction]) -> Iterator[Instruction]:
    """In "the car blue and the background grey" the background is all but the car."""
    things = [instruction.thing for instruction in instructions]
    named = [thing for thing in things if thing.scope in ("named", "marked")]
    for instruction in instructions:
        if instruction.thing.scope != "background" or not named or instruction.without:
            yield instruction
        else:
            yield replace(instruction, without=tuple(dict.fromkeys(named)))
