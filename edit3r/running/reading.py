"""The sentence of a run, read once into instructions."""

from functools import cache

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import Instruction
from edit3r.contract.interfaces import Editor, EditsRegions, Reader
from edit3r.contract.settings import PartChoice
from edit3r.kit.checks import check_instructions, errors_named_after
from edit3r.loading.registry import default_registry
from edit3r.running.config import DEFAULTS


@cache
def usual_reader() -> Reader:
    """The reader that a run takes where none is named."""
    return default_registry().build_choice(
        "reader", PartChoice(name=DEFAULTS["reader"])
    )


def read(prompt: str, reader: Reader | None = None) -> tuple[Instruction, ...]:
    """The instructions of a sentence, by `reader` or the usual one.

    Raises PromptError for one that asks for nothing.
    """
    reader = reader or usual_reader()
    if not prompt.strip():
        raise PromptError(
            "nothing is asked for; say it with --prompt, or take --editor none for the photos as "
            f"they are. {reader.abilities}"
        )
    with errors_named_after(reader):
        instructions = reader.read(prompt)
    check_instructions(reader, instructions)
    return instructions


def instructions_for(
    editor: Editor, prompt: str, reader: Reader | None = None
) -> tuple[Instruction, ...]:
    """What a chosen editor is asked, by `reader` or the usual one.

    () where the sentence cannot be read and the editor takes any; the others raise PromptError.
    """
    regional = isinstance(editor, EditsRegions)
    if not prompt.strip():
        instruction = (
            editor.instruction_of_nothing()
            if isinstance(editor, EditsRegions)
            else None
        )
        return () if instruction is None else (instruction,)
    try:
        return read(prompt, reader)
    except PromptError:
        if regional:
            raise
        return ()
