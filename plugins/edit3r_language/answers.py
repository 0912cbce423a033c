"""What a language model is asked, and its answer held to the rules that the grammar keeps.

A model answers with JSON of one form (`ModelAnswer`). Colours, materials and places in it are
looked up by the words that the grammar knows. What is not known there, and words of the sentence
that the answer speaks of nowhere, become `unread`: nothing that the user said disappears.
"""

import re
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import (
    EVERY,
    FLOOD,
    Action,
    Change,
    ChangeKind,
    Colour,
    Finish,
    Instruction,
    Target,
)
from edit3r.kit.compute.colour_names import read_colour
from edit3r_language.paints import MATERIALS
from edit3r_language.places import read_region
from edit3r_language.together import merged
from edit3r_language.vocabulary import WORDS

MAX_ANSWER = 20_000  # characters

Words = Annotated[
    str, StringConstraints(max_length=300, pattern=r"^[^\x00-\x1f\x7f]*$")
]
"""One line of a stranger's text."""
Few = Field(default=(), max_length=20)


class _Form(BaseModel):
    model_config = ConfigDict(extra="forbid")


class AnsweredTarget(_Form):
    """A thing, as a model says it."""

    scope: Literal["named", "marked", "whole", "background", "region"] = "marked"
    name: Words = ""
    which: tuple[Words, ...] = Few
    of: Words = ""
    part: Words = ""


class AnsweredChange(_Form):
    """One change of colours, as a model says it."""

    kind: ChangeKind
    colour: Words = ""
    like: AnsweredTarget | None = None
    material: Words = ""
    finish: Finish = ""
    than_now: Literal[-1, 0, 1] = 0
    amount: float = Field(default=1.0, ge=-3, le=3)


class AnsweredInstruction(_Form):
    """An instruction, as a model says it."""

    action: Action
    thing: AnsweredTarget = AnsweredTarget()
    changes: tuple[AnsweredChange, ...] = Few
    look: Words = ""
    without: tuple[AnsweredTarget, ...] = Few
    text: Words
    unread: tuple[Words, ...] = Few
    left_out: tuple[Words, ...] = Few


class ModelAnswer(_Form):
    """The whole answer."""

    instructions: tuple[AnsweredInstruction, ...] = Field(max_length=20)


@cache
def system_prompt() -> str:
    """What a model is told before the sentence."""
    return files("edit3r_language").joinpath("system_prompt.txt").read_text("utf-8")


def instructions_of_answer(answer: str, prompt: str) -> tuple[Instruction, ...]:
    """The instructions of a model's answer to a sentence.

    Raises ValueError, with what is wrong, for an answer of another form; PromptError where the
    sentence asks for nothing, or contradicts itself.
    """
    found = re.search(r"\{.*\}", answer[:MAX_ANSWER], re.DOTALL)
    if found is None:
        raise ValueError("it holds no JSON object")
    try:
        given = ModelAnswer.model_validate_json(found[0])
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the answer"
        raise ValueError(f"{where}: {first['msg']}") from None
    if not given.instructions:
        raise PromptError(f"{prompt!r} asks for no change.")
    instructions = [_Reading(one).instruction() for one in given.instructions]
    if faults := list(filter(None, (one.fault() for one in instructions))):
        raise ValueError(f"an instruction {faults[0]}")
    return merged([*instructions, *_forgotten(instructions, prompt)], prompt)


def _forgotten(instructions: list[Instruction], prompt: str) -> Iterator[Instruction]:
    """An instruction of the words that no other speaks of; fillers need not be told."""
    mentioned = {
        word
        for instruction in instructions
        for word in _words(" ".join((instruction.text, *instruction.unread)))
    }
    polite = WORDS.fillers | WORDS.politeness | {"and", "then", "but", "while"}
    forgotten = [word for word in _words(prompt) if word not in mentioned | polite]
    if forgotten:
        yield Instruction(
            "other",
            Target("whole"),
            text=prompt,
            unread=tuple(dict.fromkeys(forgotten)),
        )


def _words(text: str) -> list[str]:
    return re.findall(r"#?\w+(?:['-]\w+)*", text.lower())


class _Reading:
    """One instruction of an answer, and the words in it that nobody knows."""

    def __init__(self, given: AnsweredInstruction) -> None:
        self._given = given
        self.unread = list(given.unread)

    def instruction(self) -> Instruction:
        given = self._given
        instruction = Instruction(
            given.action,
            self._target(given.thing),
            tuple(map(self._change, given.changes)) if given.action == "paint" else (),
            look=given.look if given.action == "look" else "",
            without=tuple(map(self._target, given.without)),
            text=given.text,
            left_out=given.left_out,
        )
        if not self.unread:
            return instruction
        unread = tuple(dict.fromkeys(self.unread))
        text = given.text or " ".join(unread)
        return Instruction("other", instruction.target, text=text, unread=unread)

    def _target(self, given: AnsweredTarget) -> Target:
        part = self._colour(given.part) if given.part else None
        if given.scope == "region":
            place = read_region(given.name.lower().split())
            if place is None:
                self.unread.append(given.name or "place")
            return place or Target("whole")
        known = [word for word in given.which if _picks(word)]
        others = [word for word in given.which if not _picks(word)]  # "striped"
        name = " ".join((*others, given.name)).strip()
        return Target(given.scope, name, tuple(known), given.of, part)

    def _change(self, given: AnsweredChange) -> Change:
        material = MATERIALS.get(given.material, "")
        if given.material and not material:
            self.unread.append(given.material)
        return Change(
            given.kind,
            self._colour(given.colour or material)
            if given.colour or material
            else None,
            like=None if given.like is None else self._target(given.like),
            material=material,
            finish=given.finish,
            than_now=given.than_now,
            amount=given.amount,
        )

    def _colour(self, name: str) -> Colour | None:
        plain = name.lower().split()
        found = read_colour(plain)
        if found is not None and found[1] == len(plain):
            return found[0]
        self.unread.append(name)
        return None


def _picks(word: str) -> bool:
    """Whether a word picks one of several things, where they are looked for."""
    known = WORDS.places | WORDS.sizes | WORDS.background | EVERY | FLOOD
    found = read_colour(word.split())
    return word in known or (found is not None and found[1] == len(word.split()))
