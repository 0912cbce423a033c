"""What a language model is asked, and its answer held to the rules that the grammar keeps.

A model answers with JSON of one form (`SaidInstructions`). Colours, materials and places in it are
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
    Thing,
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


class _Said(BaseModel):
    model_config = ConfigDict(extra="forbid")


class SaidThing(_Said):
    """A thing, as a model says it."""

    scope: Literal["named", "marked", "whole", "background", "region"] = "marked"
    name: Words = ""
    which: tuple[Words, ...] = Few
    of: Words = ""
    part: Words = ""


class SaidChange(_Said):
    """One change of colours, as a model says it."""

    kind: ChangeKind
    colour: Words = ""
    like: SaidThing | None = None
    material: Words = ""
    finish: Finish = ""
    than_now: Literal[-1, 0, 1] = 0
    amount: float = Field(default=1.0, ge=-3, le=3)


class SaidInstruction(_Said):
    """An instruction, as a model says it."""

    action: Action
    thing: SaidThing = SaidThing()
    changes: tuple[SaidChange, ...] = Few
    look: Words = ""
    without: tuple[SaidThing, ...] = Few
    text: Words
    unread: tuple[Words, ...] = Few
    left_out: tuple[Words, ...] = Few


class SaidInstructions(_Said):
    """The whole answer."""

    instructions: tuple[SaidInstruction, ...] = Field(max_length=20)


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
        said = SaidInstructions.model_validate_json(found[0])
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "the answer"
        raise ValueError(f"{where}: {first['msg']}") from None
    if not said.instructions:
        raise PromptError(f"{prompt!r} asks for no change.")
    instructions = [_Reading(one).instruction() for one in said.instructions]
    if faults := list(filter(None, (one.fault() for one in instructions))):
        raise ValueError(f"an instruction {faults[0]}")
    return merged([*instructions, *_forgotten(instructions, prompt)], prompt)


def _forgotten(instructions: list[Instruction], prompt: str) -> Iterator[Instruction]:
    """An instruction of the words that no other speaks of; fillers need not be told."""
    told = {
        word
        for instruction in instructions
        for word in _words(" ".join((instruction.text, *instruction.unread)))
    }
    polite = WORDS.fillers | WORDS.politeness | {"and", "then", "but", "while"}
    forgotten = [word for word in _words(prompt) if word not in told | polite]
    if forgotten:
        yield Instruction(
            "other", Thing("whole"), text=prompt, unread=tuple(dict.fromkeys(forgotten))
        )


def _words(text: str) -> list[str]:
    return re.findall(r"#?\w+(?:['-]\w+)*", text.lower())


class _Reading:
    """One instruction of an answer, and the words in it that nobody knows."""

    def __init__(self, said: SaidInstruction) -> None:
        self.said = said
        self.unread = list(said.unread)

    def instruction(self) -> Instruction:
        said = self.said
        instruction = Instruction(
            said.action,
            self._thing(said.thing),
            tuple(map(self._change, said.changes)) if said.action == "paint" else (),
            look=said.look if said.action == "look" else "",
            without=tuple(map(self._thing, said.without)),
            text=said.text,
            left_out=said.left_out,
        )
        if not self.unread:
            return instruction
        unread = tuple(dict.fromkeys(self.unread))
        text = said.text or " ".join(unread)
        return Instruction("other", instruction.thing, text=text, unread=unread)

    def _thing(self, said: SaidThing) -> Thing:
        part = self._colour(said.part) if said.part else None
        if said.scope == "region":
            place = read_region(said.name.lower().split())
            if place is None:
                self.unread.append(said.name or "place")
            return place or Thing("whole")
        known = [word for word in said.which if _picks(word)]
        others = [word for word in said.which if not _picks(word)]  # "striped"
        name = " ".join((*others, said.name)).strip()
        return Thing(said.scope, name, tuple(known), said.of, part)

    def _change(self, said: SaidChange) -> Change:
        material = MATERIALS.get(said.material, "")
        if said.material and not material:
            self.unread.append(said.material)
        return Change(
            said.kind,
            self._colour(said.colour or material) if said.colour or material else None,
            like=None if said.like is None else self._thing(said.like),
            material=material,
            finish=said.finish,
            than_now=said.than_now,
            amount=said.amount,
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
