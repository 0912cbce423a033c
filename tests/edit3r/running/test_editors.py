"""Which editor is taken for what a sentence asks."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

import edit3r
from edit3r.contract.component import Component, Offer, component_name
from edit3r.contract.errors import PromptError
from edit3r.contract.interfaces import Editor
from edit3r.contract.reporting import Report, collecting
from edit3r.loading.load import LoadedPlugins
from edit3r.loading.registry import Registry, default_registry
from edit3r.running.editors import (
    edit_to_judge,
    tasks_for_editor,
    tasks_without_editor,
    usual_reader,
)


def chosen(prompt, registry=None):
    tasks = tasks_without_editor(prompt, usual_reader(), registry or default_registry())
    return [(component_name(task.editor), len(task.instructions)) for task in tasks]


@pytest.mark.parametrize(
    ("prompt", "editors"),
    [
        ("paint the bike red", [("recolor", 1)]),
        ("remove the bear", [("retouch", 1)]),
        ("as a pencil sketch", [("looks", 1)]),
        ("turn the bear into marble", [("looks", 1)]),
        ("the background in black and white", [("recolor", 1)]),
        ("paint the tank gold", [("recolor", 1)]),
        ("remove the bin and paint the wall white", [("retouch", 1), ("recolor", 1)]),
        ("paint the door green and the wall white", [("recolor", 2)]),
        ("make the planter look old and weathered", [("looks", 1)]),
        ("make the left cup matte black", [("recolor", 1)]),
        ("paint the door the colour of the wall", [("recolor", 1)]),
        ("brighten the left half", [("recolor", 1)]),
    ],
)
def test_the_editor_that_can_do_it_is_taken(prompt, editors):
    assert chosen(prompt) == editors


def test_what_none_can_do_names_the_words_and_who_might():
    with pytest.raises(
        PromptError, match=r"'polar'.* not understood.*model of their own"
    ):
        chosen("make it a polar bear")


@pytest.mark.parametrize(
    ("prompt", "message"),
    [
        ("paint the wall zorbic green", r"'zorbic' is no shade .* say 'into green'"),
        ("paint the sofa in turqoise", r"Did you mean 'turquoise'"),
        ("brighten the corner", r"Say which: the top right corner"),
        ("paint half of the wall red", r"Halves are of the picture"),
        ("make it look like mars", r"'mars' .* is no look that an editor here knows"),
    ],
)
def test_a_word_that_nobody_knows_is_named_with_what_to_say(prompt, message):
    with pytest.raises(PromptError, match=message):
        chosen(prompt)


def test_what_is_left_out_is_said_before_anything_runs():
    with collecting(Report()) as report:
        assert chosen("make the car glossy red") == [("recolor", 1)]
    assert "'glossy' is left out" in report.warnings[0]


def test_a_chosen_editor_that_cannot_do_it_names_who_can():
    editor = edit3r.build("editor", "recolor")
    with pytest.raises(
        PromptError, match=r"'recolor' cannot.*'remove the bear'.*--editor retouch"
    ):
        tasks_for_editor(editor, "remove the bear", usual_reader(), default_registry())


def test_an_empty_prompt_is_enough_for_an_editor_that_needs_none():
    (task,) = tasks_for_editor(
        edit3r.build("editor", "retouch"), "", usual_reader(), default_registry()
    )
    assert task.instructions[0].action == "remove"
    with pytest.raises(PromptError, match="there is nothing to do"):
        chosen("")
    with pytest.raises(PromptError, match="nothing to do"):  # before any work
        recolor = edit3r.build("editor", "recolor")
        tasks_for_editor(recolor, "", usual_reader(), default_registry())


class Anything(Editor):
    def edit(self, views, request):
        return views


def test_an_editor_that_takes_any_sentence_gets_it_whole():
    (task,) = tasks_for_editor(
        Anything(), "make it a polar bear", usual_reader(), default_registry()
    )
    assert task.prompt == "make it a polar bear"


def test_a_strangers_editor_joins_by_its_declared_actions():
    component = Component(
        "polar", f"{__name__}:Anything", "polar bears", actions=("other",)
    )
    registry = Registry(LoadedPlugins((Offer("editor", component, "polar", "1"),), ()))
    assert chosen("make it a polar bear", registry) == [("polar", 1)]


def test_a_critic_is_told_the_selected_instructions_else_those_of_the_tasks():
    tasks = tasks_without_editor(
        "paint the door green", usual_reader(), default_registry()
    )
    edit = SimpleNamespace(views=None, faults=(), moved=(), verdict=None)

    def told(instructions):
        chosen = SimpleNamespace(
            instructions=instructions, selected=(), masks=None, regions=None
        )
        asked = edit_to_judge(SimpleNamespace(start=None), chosen, edit, tasks, 2)
        return asked.instructions

    assert told(()) == tasks[0].instructions
    narrowed = (replace(tasks[0].instructions[0], action="remove"),)
    assert told(narrowed) == narrowed
