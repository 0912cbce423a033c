"""Clauses put together: changes that several things share, pronouns, and what is kept."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import EVERY, Instruction, Target
from edit3r_language.clauses import Clause, blamed
from edit3r_language.known_words import is_plural
from edit3r_language.targets import read_target
from edit3r_language.vocabulary import WORDS


def instructions_of(
    clauses: list[Clause], kept: list[Target], prompt: str
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
    kept_too = [follower.target] if follower.target is not None else []
    follower.without = [*clause.without, *kept_too]
    follower.target = clause.target
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
    target = clause.target or Target()
    if giver.target is not None and target.scope != "region":
        part = target.part or giver.target.part
        target = replace(target, part=part, name=target.name or giver.target.name)
    return replace(
        clause,
        action=giver.action,
        changes=giver.changes,
        look=giver.look,
        left_out=giver.left_out,
        target=target,
    )


# ---- pronouns, and what is kept ----


def _resolved(clauses: list[Clause], kept: list[Target]) -> Iterator[Instruction]:
    """The clauses as instructions, pronouns resolved, and what is kept left out of the thing."""
    last: Target | None = None
    clause_before: list[str] = []  # the words that named it
    for clause in clauses:
        target = clause.target or Target()
        if target.scope == "named" and not target.name and last is not None:
            target = replace(target, name=last.name)  # "the blue one"
        if target.of == "it" and last is not None:  # "its wheels"
            target = replace(target, of=_owner(last, clause_before))
        if target.scope == "region" and last is not None:
            target = _other_side(target, clause, last)
        kept = [_named_like(one, target) for one in kept]
        own = [_named_like(one, target) for one in clause.without]
        if target.scope == "background" and target.of:  # "the background of the fox"
            own, target = [*own, read_target(target.of.split())], replace(target, of="")
        without = [*own, *(one for one in kept if _matters(one, target))]
        target = _pointed_at(target, last, clause, without)
        if target.scope != "whole" or last is None:
            last, clause_before = target, clause.text.split()
        yield _instruction(clause, _all_of_name(target, without), without)


def _owner(last: Target, clause: Sequence[str]) -> str:
    """What "its" stands for: after "the house's door" it is the house, after "the cup" the cup."""
    whole = last.of.split()[-1:]
    belongs = "of" in clause or any(f"{word}'s" in clause for word in whole)
    return last.of if whole and belongs else last.name


def _other_side(region: Target, clause: Clause, last: Target) -> Target:
    """ "The lower part" after "the upper part of the statue": the statue's, not the picture's."""
    sides = [word for word in clause.text.split() if word in WORDS.places]
    if not last.of or last.name not in WORDS.places or not sides:
        return region
    return Target("named", " ".join(sides), of=last.of)


def _named_like(kept: Target, target: Target) -> Target:
    """ "The middle one", which is kept of the cups, by its name."""
    if kept.of == "it":  # "but not its base"
        return replace(kept, of=target.name or "it")
    if kept.name or kept.scope != "named":
        return kept
    return replace(kept, name=target.name)


def _matters(kept: Target, target: Target) -> bool:
    """Whether keeping `kept` matters to an instruction on `thing`: a bike has no background."""
    return kept.scope != "background" or target.scope == "whole"


def _pointed_at(
    target: Target, last: Target | None, clause: Clause, without: Sequence[Target]
) -> Target:
    """What "it" or no name at all stands for.

    What was named last in the sentence. Without any, looks and adjustments are about the whole; its
    name stays "it" where the sentence says so, since an earlier run may have named something.
    """
    if target.scope != "marked" or target.part is not None:
        return target
    subject = target.name in WORDS.object  # "the foreground"
    if last is not None and not (subject and last.scope == "background"):
        return last
    if subject:
        return replace(target, name="")
    kinds = {change.kind for change in clause.changes}
    adjusts = bool(kinds) and not kinds & {"paint", "random"}
    is_it = target.name == "it"
    if without:
        return Target("marked" if is_it else "whole")
    if clause.action == "look" or adjusts:
        return Target("whole", "it" if is_it and not target.qualifiers else "")
    return replace(target, name="") if is_it else target


def _all_of_name(target: Target, without: Sequence[Target]) -> Target:
    """All of the cups, where one of them is left out: "the cups but the middle one"."""
    one_of_them = any(kept.name == target.name and kept.qualifiers for kept in without)
    several = is_plural(target.name.split()[-1]) if target.name else False
    if not one_of_them or not several or set(target.qualifiers) & EVERY:
        return target
    return replace(target, qualifiers=("all", *target.qualifiers))


def _instruction(
    clause: Clause, target: Target, without: Sequence[Target]
) -> Instruction:
    return Instruction(
        action=clause.action or "other",
        target=target,
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
        about = instruction.target, instruction.without, instruction.look
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
    things = [instruction.target for instruction in instructions]
    named = [target for target in things if target.scope in ("named", "marked")]
    for instruction in instructions:
        if instruction.target.scope != "background" or not named or instruction.without:
            yield instruction
        else:
            yield replace(instruction, without=tuple(dict.fromkeys(named)))
