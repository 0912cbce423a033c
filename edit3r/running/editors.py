"""The sentence of a run, read once into instructions, and which editor carries out which."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import groupby

from edit3r.contract.component import Offer, component_name
from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import Instruction
from edit3r.contract.interfaces import Editor, EditsRegions, EditToJudge, Reader
from edit3r.contract.reporting import say, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import EditRequest
from edit3r.kit import asking
from edit3r.kit.weights.find import at_hand
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.config import DEFAULTS
from edit3r.running.records import EditedPhotos, Inputs, SelectedRegions


@dataclass(frozen=True)
class EditorTask:
    """One editor and what it has to do, in the order of the sentence."""

    editor: Editor
    prompt: str  # the sentence, or the part of it that is this editor's
    # () where the sentence could not be read
    instructions: tuple[Instruction, ...] = ()


def request_of(
    task: EditorTask, selection: SelectedRegions, seed: int, instructions: range
) -> EditRequest:
    """What one editor is asked; `instructions` says which of the sentence are its own."""
    regions = None
    if selection.regions is not None:
        regions = selection.regions[instructions.start : instructions.stop]
    asked = (
        selection.instructions[instructions.start : instructions.stop]
        or task.instructions
    )
    if asked:
        say("edit.understood", "; ".join(map(str, asked)))
    return EditRequest(task.prompt, seed, selection.masks, asked, regions)


def edit_to_judge(
    inputs: Inputs,
    selection: SelectedRegions,
    edit: EditedPhotos,
    tasks: tuple[EditorTask, ...],
    count: int,
) -> EditToJudge:
    """What a critic is told of the edit of the first `count` views."""
    return EditToJudge(
        before=inputs.start,
        after=edit.views,
        edited=range(count),
        instructions=selection.instructions
        or tuple(instruction for task in tasks for instruction in task.instructions),
        selected=selection.selected,
        masks=selection.masks,
        regions=selection.regions,
        faults=edit.faults,
        moved=edit.moved,
        in_2d=edit.verdict,
    )


def tasks_for_editor(
    editor: Editor, prompt: str, reader: Reader, registry: Registry
) -> tuple[EditorTask, ...]:
    """The whole prompt as the task of an editor that the user chose.

    Raises PromptError for an instruction that it cannot carry out, with the editors that can.
    """
    instructions = instructions_for(editor, prompt, reader)
    for instruction in instructions:
        if not asking.understands(editor, instruction):
            raise PromptError(_refusal(editor, instruction, reader, registry))
    if isinstance(editor, EditsRegions):
        _tell_left_out(instructions)
    return (EditorTask(editor, prompt, instructions),)


def tasks_without_editor(
    prompt: str, reader: Reader, registry: Registry
) -> tuple[EditorTask, ...]:
    """For each instruction of the prompt the installed editor that can carry it out.

    Editors without learned weights come first; others only where their weights are on this machine.
    Raises PromptError for an instruction that none can carry out.
    """
    built: dict[str, Editor] = {}
    chosen: list[tuple[str, Instruction]] = []
    for instruction in read(prompt, reader):
        for offer in _able(instruction, registry):
            name = offer.qualified_name
            if name not in built:
                built[name] = registry.build_choice("editor", PartChoice(name=name))
            if asking.understands(built[name], instruction):
                chosen.append((name, instruction))
                break
        else:
            raise PromptError(_nobody(instruction, reader, registry))
    # first: what is filled in from other photos must not bring back what is hidden there
    chosen.sort(key=lambda pair: not asking.hides(built[pair[0]], pair[1]))
    _tell_left_out(instruction for _, instruction in chosen)
    tasks = []
    for name, group in groupby(chosen, key=lambda pair: pair[0]):
        instructions = tuple(instruction for _, instruction in group)
        whole = len(instructions) == len(chosen)
        text = (
            prompt
            if whole
            else ", ".join(instruction.text for instruction in instructions)
        )
        tasks.append(EditorTask(built[name], text, instructions))
    return tuple(tasks)


def _tell_left_out(instructions: Iterable[Instruction]) -> None:
    """Say, before anything runs, which words of the sentence will not be carried out."""
    for word in dict.fromkeys(
        word for instruction in instructions for word in instruction.left_out
    ):
        warn(
            f"{word!r} is left out: highlights that no photo shows are not invented; the rest of "
            "the sentence is carried out."
        )


def _able(instruction: Instruction, registry: Registry) -> Iterator[Offer]:
    """Editors that declare the instruction's action and can be used here.

    Those without weights come first, then those that declare the action before others.
    """
    offers = [
        one
        for one in registry.offers("editor")
        if instruction.action in one.component.actions
    ]
    for offer in sorted(
        offers,
        key=lambda one: (
            bool(one.component.weights),
            one.component.actions.index(instruction.action),
        ),
    ):
        component = offer.component
        ready = all(at_hand(weights) is not None for weights in component.weights)
        service = component.needs_network and not component.weights  # never unasked
        if ready and not service and not registry.missing(offer):
            yield offer


def _refusal(
    editor: Editor, instruction: Instruction, reader: Reader, registry: Registry
) -> str:
    name = component_name(editor)
    others = [offer.component.name for offer in _able(instruction, registry)]
    others = [other for other in others if other != name]
    if not others:
        return f"editor {name!r}: {_nobody(instruction, reader, registry)}"
    return (
        f"editor {name!r} cannot carry out {instruction.text!r}; {' or '.join(map(repr, others))} "
        f"can: --editor {others[0]}, or leave --editor out."
    )


def _nobody(instruction: Instruction, reader: Reader, registry: Registry) -> str:
    """That no installed editor can do it, which words are to blame, and which others might."""
    unread = ", ".join(repr(word) for word in instruction.unread)
    verb = "are" if len(instruction.unread) > 1 else "is"
    reason = f"no editor here can carry out {instruction.text!r}"
    if instruction.action == "look":
        look = f"{instruction.look!r} in {instruction.text!r}"
        reason = f"{look} is no look that an editor here knows"
    if unread:
        reason = f"{unread} in {instruction.text!r} {verb} not understood"
    learned = any("other" in one.component.actions for one in registry.offers("editor"))
    more = " Editors with a model of their own may do more (edit3r list-plugins --kind editor)."
    hint = asking.hint(reader, instruction)
    return f"{reason}.{hint} {reader.abilities}{more if learned else ''}"


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
            "there is nothing to do; say what to change with --prompt, or keep the photos as they "
            f"are with --editor none. {reader.abilities}"
        )
    return asking.read(reader, prompt)


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
        if regional and instruction is None:
            return read(prompt, reader)  # which says that nothing is asked for
        return () if instruction is None else (instruction,)
    try:
        return read(prompt, reader)
    except PromptError:
        if regional:
            raise
        return ()
