"""Settings classes as the fields of a form, and what was typed there as settings."""

import types
from dataclasses import dataclass
from typing import Any, Literal, Union, get_args, get_origin

from edit3r.component import KINDS
from edit3r.config import PartChoice, Settings, parse_yaml
from edit3r.description import settings_lines
from edit3r.errors import SettingsError
from edit3r.registry import Registry, install_hint

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


def form_fields(cls: type[Settings], registry: Registry, without: tuple[str, ...] = ()) -> tuple[FormField, ...]:
    """The fields for a settings class; what has no plain form is a line of YAML."""
    fields = []
    for line in settings_lines(cls):
        if line.name in without:
            continue
        annotation = cls.model_fields[line.name].annotation
        if annotation is bool:
            fields.append(FormField(line.name, "switch", line.sentence, "", bool(line.default)))
            continue
        options = _options(annotation)
        words = [str(word) for kind in options if get_origin(kind) is Literal for word in get_args(kind)]
        whole = all(get_origin(kind) is Literal or kind is type(None) for kind in options)
        if PartChoice in options and line.name in KINDS and "name" not in line.default_yaml:
            words, whole = [offer.component.name for offer in registry.offers(line.name)], True
        default = line.default_yaml if isinstance(line.default, list | dict) else _as_text(line.default)
        form: Literal["choice", "text"] = "choice" if words and whole else "text"
        choices = ("", *words) if type(None) in options else tuple(words)
        fields.append(FormField(line.name, form, line.sentence, line.allowed, default, choices if words else ()))
    return tuple(fields)


def read_form(fields: tuple[FormField, ...], values: dict[str, Any]) -> dict[str, Any]:
    """What differs from the defaults, as settings. Raises SettingsError for a line that is no YAML."""
    settings: dict[str, Any] = {}
    for field in fields:
        value = values.get(field.name, field.default)
        if value == field.default or value is None:
            continue
        if field.form == "text" and field.hint.partition(",")[0] not in ("text", "text or null"):
            try:
                value = parse_yaml(str(value)[:2000])
            except ValueError as error:
                raise SettingsError(f"{field.name}: {error}.") from None
        settings[field.name] = value
    return settings


def offered(registry: Registry, kind: str) -> dict[str, str]:
    """Names of the components that can be chosen, each with its summary and what is to be known before."""
    found = {}
    for offer in registry.offers(kind):
        if offer.component.name not in RUNS_PROGRAMS and not registry.missing(offer):
            needs = (("a GPU", offer.component.needs_gpu), ("the network", offer.component.needs_network))
            told = "".join(f"; needs {what}" for what, so in needs if so)
            found[offer.component.name] = offer.component.summary + told
    return found


def not_installed(registry: Registry, kind: str) -> list[str]:
    """A sentence for each component that lacks a package."""
    lacking = [offer for offer in registry.offers(kind) if registry.missing(offer)]
    return [f"{offer.component.name}: {install_hint(offer)}" for offer in lacking]


def _options(annotation: Any) -> tuple[Any, ...]:
    union = get_origin(annotation) in (Union, types.UnionType)
    return get_args(annotation) if union else (annotation,)


def _as_text(value: Any) -> str:
    return "" if value is None else str(value).lower() if isinstance(value, bool) else str(value)
