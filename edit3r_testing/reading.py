"""Contract of a reader of sentences."""

from contextlib import suppress
from typing import ClassVar

from edit3r.contract.errors import PluginError, PromptError
from edit3r.contract.instructions import Instruction, Target
from edit3r.contract.interfaces import Reader
from edit3r.kit import asking
from edit3r_testing.contract import Contract, ContractViolation

NO_WORDS = "qwxz vbnk"
STRANGE = ("", "  ", "...", "\N{SNOWMAN}\0", "and, and; but", "a" * 9000, "x, " * 3000)


class ReaderContract(Contract):
    """Instructions that hold together, of any text; what is not understood is named."""

    kind = "reader"
    subject: Reader
    target: ClassVar[str] = "the wall"  # as its language names one

    def read(self, text: str) -> tuple[Instruction, ...]:
        """The instructions of a text, checked as every run does. Raises PromptError for none."""
        try:
            return asking.read(self.subject, text)
        except PluginError as error:
            raise ContractViolation(str(error)) from error

    def test_reads_a_sentence_of_its_language(self) -> None:
        """Its `example` gives instructions that editors can carry out, each with its words."""
        try:
            instructions = self.read(self.subject.example)
        except PromptError as error:
            self.require(
                False, f"{self.subject.example!r} is refused: {error} Set `example`."
            )
        for instruction in instructions:
            self.require(
                instruction.action != "other",
                f"{self.subject.example!r} is not understood ({instruction.unread}); set "
                "`example` to one that is.",
            )
            self.require(
                instruction.text,
                f"{instruction!r} has no text; set the words that ask for it.",
            )

    def test_names_what_it_does_not_understand(self) -> None:
        """Words that are none are refused, or stand in `unread`: nothing disappears."""
        with suppress(PromptError):
            instructions = self.read(NO_WORDS)
            fix = "return one of action 'other' with them in `unread`, or raise PromptError"
            self.require(
                any(instruction.unread for instruction in instructions),
                f"{NO_WORDS!r} is read as {instructions!r}; {fix}.",
            )

    def test_any_text_is_read_or_refused(self) -> None:
        for text in STRANGE:
            with suppress(PromptError):
                self.read(text)

    def test_same_sentence_gives_the_same_instructions(self) -> None:
        if self.offer is not None and not self.offer.component.supports_seed:
            return
        first, second = self.read(self.subject.example), self.read(self.subject.example)
        fix = "read without chance, or say supports_seed=False"
        self.require(
            first == second, f"read twice, a sentence gave other instructions; {fix}."
        )

    def test_reads_a_thing_alone(self) -> None:
        """As it stands after `--thing`: "the left cup"."""
        named = self.ask(asking.read_target, self.target)
        self.require(
            named.name or named.scope != "named",
            f"read_target({self.target!r}) has no name; name what segmenters shall look for.",
        )

    def test_hints_end_an_error(self) -> None:
        instruction = Instruction(
            "other", Target(), text=NO_WORDS, unread=tuple(NO_WORDS.split())
        )
        hint = self.ask(asking.hint, instruction)
        self.require(
            hint == "" or hint.startswith(" "),
            f"hint() gave {hint!r}; it follows a sentence, so begin it with a space.",
        )
