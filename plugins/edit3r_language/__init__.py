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
        Component(
            "model",
            "edit3r_language.model:ServiceReader",
            "any language, by a language model of OpenAI's or of a server of your own; needs "
            "OPENAI_API_KEY in the environment, or reader.base_url",
            requires=("openai",),
            extra="openai",
            licence="Apache-2.0; the service has its own terms",
            needs_network=True,
            supports_seed=False,
        ),
        Component(
            "local-model",
            "edit3r_language.model:LocalReader",
            "any language, by a chat model on this machine",
            requires=("transformers",),
            extra="transformers",
            licence="Apache-2.0; the model has its own",
            needs_network=True,
        ),
    ]
