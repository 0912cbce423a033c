"""Which editor carries out which wish of the prompt."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby

from edit3r.contract.component import Offer, component_name
from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import Editor, EditsRegions, EditToJudge, Reader
from edit3r.contract.reporting import say, warn
from edit3r.contract.settings import PartChoice
from edit3r.contract.types import EditRequest
from edit3r.contract.wishes import Wish
from edit3r.kit.weights.find import at_hand
from edit3r.loading.registry import Registry
from edit3r.running.reading import read, wishes_for
from edit3r.running.records import EditedPhotos, Inputs, SelectedRegions


@dataclass(frozen=True)
class EditorTask:
    """One editor and what it has to do, in the order of the sentence."""

    editor: Editor
    prompt: str  # the sentence, or the part of it that is this editor's
    wishes: tuple[Wish, ...] = ()  # () where the sentence could not be read


def request_of(
    task: EditorTask, selection: SelectedRegions, seed: int, wishes: range
) -> EditRequest:
    """What one editor is asked; its wishes are those at `wishes` of the whole sentence."""
    regions = None
    if selection.regions is not None:
        regions = selection.regions[wishes.start : wishes.stop]
    asked = selection.wishes[wishes.start : wishes.stop] or task.wishes
    if asked:
        say("edit.understood", "; ".join(map(str, asked)))
    return EditRequest(task.prompt, seed, selection.masks, asked, regions)


def edit_to_judge(
    inputs: Inputs,
    selection: SelectedRegions,
    made: EditedPhotos,
    tasks: tuple[EditorTask, ...],
    count: int,
) -> EditToJudge:
    """What a critic is told of the edit of the first `count` views."""
    return EditToJudge(
        before=inputs.start,
        after=made.views,
        edited=range(count),
        wishes=selection.wishes
        or tuple(wish for task in tasks for wish in task.wishes),
        selected=selection.selected,
        masks=selection.masks,
        regions=selection.regions,
        faults=made.faults,
        moved=made.moved,
        in_2d=made.verdict,
    )


def tasks_for_editor(
    editor: Editor, prompt: str, reader: Reader, registry: Registry
) -> tuple[EditorTask, ...]:
    """The whole prompt as the task of an editor that the user chose.

    Raises PromptError for a wish that it cannot carry out, with the editors that can.
    """
    wishes = wishes_for(editor, prompt, reader)
    for wish in wishes:
        if not editor.understands(wish):
            raise PromptError(_refusal(editor, wish, reader, registry))
    if isinstance(editor, EditsRegions):
        _tell_left_out(wishes)
    return (EditorTask(editor, prompt, wishes),)


def tasks_without_editor(
    prompt: str, reader: Reader, registry: Registry
) -> tuple[EditorTask, ...]:
    """For each wish of the prompt the installed editor that can carry it out.

    Editors without learned weights come first; others only where their weights are on this machine.
    Raises PromptError for a wish that none can carry out.
    """
    built: dict[str, Editor] = {}
    chosen: list[tuple[str, Wish]] = []
    for wish in read(prompt, reader):
        for offer in _able(wish, registry):
            name = offer.qualified_name
            if name not in built:
                built[name] = registry.build_choice("editor", PartChoice(name=name))
            if built[name].understands(wish):
                chosen.append((name, wish))
                break
        else:
            raise PromptError(_nobody(wish, reader, registry))
    _tell_left_out(wish for _, wish in chosen)
    tasks = []
    for name, group in groupby(chosen, key=lambda pair: pair[0]):
        wishes = tuple(wish for _, wish in group)
        whole = len(wishes) == len(chosen)
        text = prompt if whole else ", ".join(wish.text for wish in wishes)
        tasks.append(EditorTask(built[name], text, wishes))
    return tuple(tasks)


def _tell_left_out(wishes: Iterable[Wish]) -> None:
    """Say, before anything runs, which words of the sentence will not be carried out."""
    for word in dict.fromkeys(word for wish in wishes for word in wish.left_out):
        warn(
            f"{word!r} is left out: highlights that no photo shows are not invented; the rest of "
            "the sentence is carried out."
        )


def _able(wish: Wish, registry: Registry) -> Iterator[Offer]:
    """Editors that declare the wish's action and can be used here.

    Those without weights come first, then those that declare the action before others.
    """
    offers = [
        one for one in registry.offers("editor") if wish.action in one.component.actions
    ]
    for offer in sorted(
        offers,
        key=lambda one: (
            bool(one.component.weights),
            one.component.actions.index(wish.action),
        ),
    ):
        component = offer.component
        ready = all(at_hand(weights) is not None for weights in component.weights)
        service = component.needs_network and not component.weights  # never unasked
        if ready and not service and not registry.missing(offer):
            yield offer


def _refusal(editor: Editor, wish: Wish, reader: Reader, registry: Registry) -> str:
    name = component_name(editor)
    others = [offer.component.name for offer in _able(wish, registry)]
    others = [other for other in others if other != name]
    if not others:
        return f"editor {name!r}: {_nobody(wish, reader, registry)}"
    return (
        f"editor {name!r} cannot carry out {wish.text!r}; {' or '.join(map(repr, others))} can: "
        f"--editor {others[0]}, or leave --editor out."
    )


def _nobody(wish: Wish, reader: Reader, registry: Registry) -> str:
    """That no installed editor can do it, which words are to blame, and which others might."""
    unread = ", ".join(repr(word) for word in wish.unread)
    verb = "are" if len(wish.unread) > 1 else "is"
    reason = f"no editor here can carry out {wish.text!r}"
    if wish.action == "look":
        reason = f"{wish.look!r} in {wish.text!r} is no look that an editor here knows"
    if unread:
        reason = f"{unread} in {wish.text!r} {verb} not understood"
    learned = [
        offer.component.name
        for offer in registry.offers("editor")
        if "other" in offer.component.actions
    ]
    more = ""
    if learned:
        more = (
            f" Editors with a model of their own may do it: {', '.join(learned)} (edit3r "
            "list-plugins --kind editor says what each needs)."
        )
    return f"{reason}.{reader.hint(wish)} {reader.abilities}{more}"
