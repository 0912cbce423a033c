"""The reader's contract finds every way of breaking it."""

import itertools

import pytest

from edit3r.contract.instructions import Change, Instruction, Target
from edit3r.contract.interfaces import Reader
from edit3r_testing import ReaderContract


class SpoiledReader(Reader):
    """Reads by a function."""

    def __init__(self, read, thing=None, hint=""):
        self._read, self._thing, self._hint = (
            read,
            thing or Target("named", "wall"),
            hint,
        )

    def read(self, prompt):
        return self._read(prompt)

    def read_target(self, words):
        return self._thing

    def hint(self, instruction):
        return self._hint


NUMBERS = itertools.count()
REMOVE = Instruction("remove", Target(), text="remove it")


def understands_all(prompt):
    return (REMOVE,)


def understands_none(prompt):
    return (Instruction("other", Target(), text=prompt, unread=tuple(prompt.split())),)


READS = "test_reads_a_sentence_of_its_language"
NAMES = "test_names_what_it_does_not_understand"
ANY = "test_any_text_is_read_or_refused"
SAME = "test_same_sentence_gives_the_same_instructions"
CASES = {
    "nothing": (lambda prompt: (), READS, "return an instruction"),
    "a list": (lambda prompt: [REMOVE], READS, "tuple"),
    "no instruction": (lambda prompt: ("red",), READS, "Instruction"),
    "no colour": (
        lambda prompt: (Instruction("paint", Target(), (Change("paint"),), text="a"),),
        READS,
        "names no colour",
    ),
    "no box": (
        lambda prompt: (Instruction("remove", Target("region"), text="a"),),
        READS,
        "without a box",
    ),
    "no words": (
        lambda prompt: (Instruction("remove", Target()),),
        READS,
        "has no text",
    ),
    "another language": (understands_none, READS, "set `example`"),
    "a guess": (understands_all, NAMES, "in `unread`"),
    "another error": (
        lambda prompt: prompt.split()[0] and (REMOVE,),
        ANY,
        "IndexError",
    ),
    "chance": (
        lambda prompt: (Instruction("remove", Target(), text=f"{next(NUMBERS)}"),),
        SAME,
        "gave other instructions",
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_the_contract_names_what_is_wrong(case, complaint):
    read, claim, told = CASES[case]
    assert told in complaint(ReaderContract, lambda: SpoiledReader(read), claim)


def test_a_thing_has_a_name_and_a_hint_ends_a_sentence(complaint):
    def build():
        return SpoiledReader(understands_all, Target("named"), "Near: red.")

    assert "has no name" in complaint(ReaderContract, build, "test_reads_a_thing_alone")
    assert "begin it with a space" in complaint(
        ReaderContract, build, "test_hints_end_an_error"
    )
