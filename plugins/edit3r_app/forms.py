"""Settings in words, and what was typed for them as settings of a run."""

import re
from typing import Any

from edit3r import Registry
from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import is_user_only
from edit3r.kit.files.configs import parse_assignments
from edit3r.loading import SettingLine, settings_lines
from edit3r.running import RunConfig, check_components, make_run_config
from edit3r_app.draft import Draft

CHOSEN = ("editor", "reconstructor")
NOT_IN_FORM = (*CHOSEN, *Draft().outline, "prompt", "quality", "size", "guess")
"""Settings of a run that have a place of their own, or that masks were made for."""
RUNS_PROGRAMS = "command"
"""An editor that starts a program of the user's choice: not for a page that others may reach."""
MAX_TYPED = 2000  # characters of one setting

WORDS = {
    r" or null\b": ", or empty",
    r"^list of (\d+) float": r"\1 numbers, such as [0.1, 0.2]",
    r"^list of [^,]*": "a list, such as [a, b]",
    r"^mapping of [^,]*|^[A-Z]\w+": "settings, such as {a: 1}",
    r"\bfloat\b": "a number",
    r"\bint\b": "a whole number",
    r"\bcomponent\b": "the name of a component",
    r" \| ": ", ",
    "≥": "at least",
    "≤": "at most",
    ">": "above",
    "<": "below",
}
"""How types and ranges are said in a form."""


def form_lines(registry: Registry, kind: str, name: str) -> tuple[SettingLine, ...]:
    """The settings that a form shows: of a component or, of kind "run", of the run."""
    if kind == "run":
        lines = settings_lines(RunConfig)
        return tuple(line for line in lines if line.name not in NOT_IN_FORM)
    cls = registry.settings_class(registry.find(kind, name))
    return tuple(
        line
        for line in settings_lines(cls)
        if not is_user_only(cls.model_fields[line.name])
    )


def in_words(line: SettingLine) -> str:
    """What a setting is for and may be; "float or null" is "a number, or empty"."""
    allowed = line.allowed
    for pattern, words in WORDS.items():
        allowed = re.sub(pattern, words, allowed)
    return f"{line.sentence} ({allowed}; default {line.default_yaml})"


def run_settings(draft: Draft, registry: Registry) -> dict[str, Any]:
    """The settings of a run as a draft says; raises SettingsError where they are none.

    The draft's form holds prompt, editor, reconstructor, quality and, under "settings", what was
    typed for the settings of "run", "editor NAME" and "reconstructor NAME". What is empty is left
    to the run's own defaults.
    """
    form = draft.form
    settings = _typed(form, "run")
    settings["prompt"] = str(form.get("prompt", "")).strip()
    settings["guess"] = draft.guess
    settings |= {key: value for key, value in draft.outline.items() if value}
    if form.get("quality"):
        settings["quality"] = form["quality"]
    for kind in CHOSEN:
        name = form.get(kind)
        if name:
            if name not in offered(registry, kind):
                raise SettingsError(f"{kind} {str(name)[:60]!r} cannot be chosen here.")
            settings[kind] = {"name": name, **_typed(form, f"{kind} {name}")}
    if _names_program({**settings, "prompt": ""}):
        raise SettingsError(
            f"{RUNS_PROGRAMS} starts programs of your choice, which only edit3r run does."
        )
    check_components(make_run_config(settings), registry)
    return settings


def _typed(form: dict[str, Any], group: str) -> dict[str, Any]:
    """What was typed for one group of settings, read as `--set` reads it."""
    typed = form.get("settings", {}).get(group, {})
    texts = [f"{name}={str(text)[:MAX_TYPED]}" for name, text in typed.items() if text]
    return parse_assignments(texts)


def _names_program(value: Any) -> bool:
    """Whether settings of any depth choose a component that starts programs."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return any(map(_names_program, value))
    return isinstance(value, str) and value.strip().rpartition(":")[2] == RUNS_PROGRAMS


def offered(registry: Registry, kind: str) -> dict[str, str]:
    """Names of the components that can be chosen, each with its summary and what it needs."""
    found = {}
    for offer in registry.offers(kind):
        component = offer.component
        if component.name == RUNS_PROGRAMS or registry.missing(offer):
            continue
        told = component.summary
        if "cuda" in component.devices:
            told += "; needs a GPU"
        if component.needs_network:
            told += "; needs the network"
        found[component.name] = told
    return found
