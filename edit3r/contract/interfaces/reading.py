"""Readers: what a sentence asks for, as instructions."""

from abc import ABC, abstractmethod
from typing import ClassVar

from edit3r.contract.component import Configured
from edit3r.contract.instructions import Instruction, Target


class Reader(Configured, ABC):
    """Reads a sentence into instructions (`edit3r.contract.instructions`), which editors carry out.

    A run asks its reader once. No word may disappear: what is not understood stands in `unread` of
    an instruction of action "other", what nobody can carry out in `left_out` of its instruction.
    """

    abilities: ClassVar[str] = ""
    """What may be said, in a sentence or two, as errors tell it; "" where that is anything."""

    example: ClassVar[str] = "paint the wall red"
    """A sentence of its language that it understands."""

    @abstractmethod
    def read(self, prompt: str) -> tuple[Instruction, ...]:
        """The instructions of a sentence, in its order, at least one.

        The same sentence gives the same ones, unless the component says `supports_seed=False`.
        Raises PromptError for a sentence that asks for nothing, or that contradicts itself, as by
        two colours on one thing.
        """

    @abstractmethod
    def read_target(self, words: str) -> Target:
        """The thing that words name, such as "the left cup" (`--thing`)."""

    def hint(self, instruction: Instruction) -> str:
        """What to say instead of words not read or a thing not found: " Did you mean ...?".

        It ends an error.
        """
        return ""

    def after_undo(self, prompt: str) -> str | None:
        """The rest of a sentence that first takes back the last edit; None for any other.

        "Undo that and make its plaque red" leaves "make its plaque red", "undo" leaves "".
        """
        return None
