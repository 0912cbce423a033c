"""Settings classes as the fields of a form, and what was typed there as settings."""

import types
from dataclasses import dataclass
from typing import Any, Literal, Union, get_args, get_origin

from edit3r.config import (
    PartChoice,
    Settings,
    is_user_only,
    make_settings,
    parse_yaml,
)
from edit3r.contract.component import KINDS
from edit3r.errors import SettingsError
from edit3r.pipeline.config import DEFAULTS, RunConfig, make_run_config
from edit3r.plugins.describe import settings_lines
from edit3r.plugins.registry import Registry

NOT_IN_FORM = ("prompt", "editor", "reconstructor", "quality", "size")
"""Settings of a run that have a place of their own, or that masks were made for."""
CHOSEN = ("editor", "reconstructor")
RUNS_PROGRAMS = {"command"}
"""Editors that start a program of the user's choice: not for a page that others may reach."""


@dataclass(frozen=True)
class FormField:
    """One setting as a form shows it."""

    name: str
    form: Literal["switch", "choice", "text"]
    label: str  # its description
    hint: str  # type and range
    default: str | bool  # as the form holds it
    choices: tuple[str, ...] = ()


def form_fields(
    cls: type[Settings], registry: Registry, without: tuple[str, ...] = ()
) -> tuple[FormField, ...]:
    """The fields for a settings class; what has no plain form is a line of YAML."""
    fields = []
    for line in settings_lines(cls):
        setting = cls.model_fields[line.name]
        if line.name in without or is_user_only(setting):
            continue
        annotation = setting.annotation
        if annotation is bool:
            fields.append(
                FormField(line.name, "switch", line.sentence, "", bool(line.default))
            )
            continue
        options = _options(annotation)
        words = [
            str(word)
            for kind in options
            if get_origin(kind) is Literal
            for word in get_args(kind)
        ]
        whole = all(
            get_origin(kind) is Literal or kind is type(None) for kind in options
        )
        if (
            PartChoice in options
            and line.name in KINDS
            and "name" not in line.default_yaml
        ):
            words, whole = list(offered(registry, line.name)), True
        default = (
            line.default_yaml
            if isinstance(line.default, list | dict)
            else _as_text(line.default)
        )
        form: Literal["choice", "text"] = "choice" if words and whole else "text"
        choices = ("", *words) if type(None) in options else tuple(words)
        fields.append(
            FormField(
                line.name,
                form,
                line.sentence,
                line.allowed,
                default,
                choices if words else (),
            )
        )
    return tuple(fields)


def read_form(fields: tuple[FormField, ...], values: dict[str, Any]) -> dict[str, Any]:
    """What differs from the defaults, as settings. Raises SettingsError for a line that is no
    YAML.
    """
    settings: dict[str, Any] = {}
    for field in fields:
        value = values.get(field.name, field.default)
        if value == field.default or value is None:
            continue
        if field.form == "choice" and value == "":
            value = None
        if field.form == "text" and field.hint.partition(",")[0] not in (
            "text",
            "text or null",
        ):
            try:
                value = parse_yaml(str(value)[:2000])
            except ValueError as error:
                raise SettingsError(f"{field.name}: {error}.") from None
        settings[field.name] = value
    return settings


def run_settings(form: dict[str, Any], registry: Registry) -> dict[str, Any]:
    """The settings of a run as a form's values say; raises SettingsError where they are none.

    Keys of `form`: prompt, editor, reconstructor, quality, and settings, which holds the values of
    inner forms under "run", "editor NAME" or "reconstructor NAME". What is empty is left to the
    run's own defaults.
    """
    inner = form.get("settings", {})
    settings = read_form(
        form_fields(RunConfig, registry, NOT_IN_FORM), inner.get("run", {})
    )
    settings["prompt"] = str(form.get("prompt", "")).strip()
    if form.get("quality"):
        settings["quality"] = form["quality"]
    for kind in CHOSEN:
        name = form.get(kind) or (DEFAULTS[kind] if kind == "editor" else "")
        if name and name not in offered(registry, kind):
            raise SettingsError(f"{kind} {str(name)[:60]!r} cannot be chosen here.")
        if name:
            cls = registry.settings_class(registry.find(kind, name))
            chosen = read_form(
                form_fields(cls, registry), inner.get(f"{kind} {name}", {})
            )
            make_settings(cls, chosen, where=kind)
            settings[kind] = {"name": name, **chosen}
    if _names_program(settings):
        raise SettingsError(
            f"{', '.join(RUNS_PROGRAMS)} starts programs of your choice, which only edit3r run "
            "does."
        )
    make_run_config(settings)
    return settings


def _names_program(value: Any) -> bool:
    """Whether settings of any depth choose a component that starts programs."""
    if isinstance(value, dict):
        return any(
            _names_program(inner) for key, inner in value.items() if key != "prompt"
        )
    if isinstance(value, list | tuple):
        return any(map(_names_program, value))
    return isinstance(value, str) and value.strip().rpartition(":")[2] in RUNS_PROGRAMS


def offered(registry: Registry, kind: str) -> dict[str, str]:
    """Names of the components that can be chosen, each with its summary and what is to be known
    before.
    """
    found = {}
    for offer in registry.offers(kind):
        if offer.component.name not in RUNS_PROGRAMS and not registry.missing(offer):
            needs = (
                ("a GPU", "cuda" in offer.component.devices),
                ("the network", offer.component.needs_network),
            )
            told = "".join(f"; needs {what}" for what, so in needs if so)
            found[offer.component.name] = offer.component.summary + told
    return found


def _options(annotation: Any) -> tuple[Any, ...]:
    union = get_origin(annotation) in (Union, types.UnionType)
    return get_args(annotation) if union else (annotation,)


def _as_text(value: Any) -> str:
    return (
        ""
        if value is None
        else str(value).lower()
        if isinstance(value, bool)
        else str(value)
    )
