"""Readers of sentences: the grammar that runs begin with, and language models."""

from edit3r import Component, hookimpl

EDIT3R_API = 1


@hookimpl
def register_readers() -> list[Component]:
    return [
        Component(
            "grammar",
            "edit3r_language.grammar:GrammarReader",
            "plain English by rules, at once: colours, looks, places, removing",
        ),
    ]
