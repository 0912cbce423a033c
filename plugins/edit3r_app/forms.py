"""Settings in words, and what was typed for them as settings of a run."""

import math
import re
from pathlib import Path
from typing import Any, NamedTuple

from edit3r import Registry
from edit3r.contract.errors import SettingsError
from edit3r.contract.settings import is_user_only
from edit3r.kit.files.configs import parse_assignments, read_yaml
from edit3r.loading import SettingLine, settings_lines
from edit3r.running import RunConfig, check_components, make_run_config
from edit3r_app.draft import Draft
from edit3r_app.wording import in_app

CHOSEN = ("editor", "reconstructor")
BESIDE_THE_PHOTO = ("strength", "feather")
NOT_IN_FORM = (
    *CHOSEN,
    *BESIDE_THE_PHOTO,
    *Draft().outline,
    *("prompt", "quality", "size", "writer", "guess", "up"),
)
"""Settings of a run that have a place of their own, or that masks were made for."""
WHO = {
    "editor": ("Editor of the photos", "the one that can do what you ask for"),
    "reconstructor": ("Builder of the scene", "the usual one: two photos are enough"),
}
"""Of what is chosen: its label, and what is taken where nothing is."""
RUNS_PROGRAMS = "command"
"""An editor that starts a program of the user's choice: not for a page that others may reach."""
MAX_TYPED = 2000  # characters of one setting


class Explained(NamedTuple):
    """A setting in words."""

    label: str
    about: str
    unit: str = ""


def _explained() -> dict[str, Explained]:
    content = read_yaml(Path(__file__).with_name("forms.yaml"))
    return {name: Explained(**words) for name, words in content.items()}


EXPLAINED = _explained()
"""Settings of the run in words, in the order of the form."""
EXPERT = (
    *("selector", "critic", "matcher", "rasterizer", "reader", "segmenter", "refiners"),
    *("device", "outputs", "export", "max_gaussians"),
)
"""Settings of the run that name parts of edit3r; `candidate` has its place beside the outline."""
COSTS = {"": "a good middle", "best": "finer depth and more polishing; takes longer"}
"""Of the presets; the others differ in the photos' size, which is the app's own."""
CHOICES = {
    ("exposure", "one"): "alike, as in the first",
    ("exposure", "own"): "each as it is",
}
"""What a setting may be, in words, where its own name is none."""
LARGEST_SLIDER = 1000  # steps: what has more is typed


def settings_form(draft: Draft, registry: Registry) -> list[dict[str, Any]]:
    """Groups of fields as the dialog shows them: a title, and fields with their words."""
    form = draft.form
    groups = [_group("", "", [_quality(form)])]
    for kind, (label, usual_one) in WHO.items():
        names = offered(registry, kind)
        asked = form.get(kind, "")
        chosen = asked if asked in names else ""
        options = [_option("", "automatic", usual_one)]
        options += [_option(name, name, told) for name, told in names.items()]
        groups.append(_group("", "", [_select(kind, label, options, chosen)]))
        if chosen:
            typed = _texts(form, f"{kind} {chosen}")
            lines = form_lines(registry, kind, chosen)
            fields = [_field(line, typed) for line in lines]
            groups.append(_group(f"Settings of {chosen}", f"{kind} {chosen}", fields))
    typed = _texts(form, "run")
    by_name = {line.name: line for line in form_lines(registry, "run", "")}
    usual = [_field(by_name[name], typed) for name in EXPLAINED if name in by_name]
    groups.append(_group("This edit", "run", usual))
    rest = [_field(by_name[name], typed) for name in EXPERT if name in by_name]
    return [*groups, _group("For experts", "run", rest)]


def set_by_hand(settings: dict[str, Any]) -> list[str]:
    """What was set for a run beside its sentence, in words."""
    said = []
    for name, value in settings.items():
        if name in ("prompt", "guess") or value in ("", None, False):
            continue
        label = EXPLAINED.get(name, (name.replace("_", " "),))[0]
        shown = value.get("name", value) if isinstance(value, dict) else value
        said.append(f"{label}: {shown}"[:80])
    return said


def _group(title: str, group: str, fields: list[dict[str, Any]]) -> dict[str, Any]:
    return {"title": title, "group": group, "fields": fields}


def _option(value: str, label: str, told: str = "") -> dict[str, str]:
    return {"value": value, "label": label, "told": told}


def _select(
    name: str, label: str, options: list[dict[str, str]], value: str, help: str = ""
) -> dict[str, Any]:
    made = {"name": name, "label": label, "kind": "select", "options": options}
    return {**made, "value": value, "help": help, "unit": ""}


def _quality(form: dict[str, Any]) -> dict[str, Any]:
    options = [_option(name, name or "automatic", told) for name, told in COSTS.items()]
    return _select("quality", "Quality and time", options, form.get("quality", ""))


def _texts(form: dict[str, Any], group: str) -> dict[str, Any]:
    return form.get("settings", {}).get(group, {})


def _field(line: SettingLine, typed: dict[str, Any]) -> dict[str, Any]:
    """One setting as a switch, a select, a slider, a number or a text, with its words."""
    plain = line.name.replace("_", " ")
    sentence = in_app(line.sentence)
    usual = (plain[:1].upper() + plain[1:], sentence, "")
    label, told, unit = EXPLAINED.get(line.name, usual)
    default = "" if line.default is None else _as_text(line.default)
    value = str(typed.get(line.name, ""))
    made = {"name": line.name, "label": label, "help": told, "unit": unit}
    made |= {"value": value, "default": default}
    kind = line.type.removesuffix(" or null")
    low, high = _bounds(line.range)
    if kind == "true or false":
        return {**made, "kind": "switch"}
    if " | " in kind and " or " not in kind:
        options = [
            _option(name, CHOICES.get((line.name, name), name.replace("_", " ")))
            for name in kind.split(" | ")
        ]
        return {**made, "kind": "select", "options": options}
    if kind not in ("int", "float"):
        return {**made, "kind": "text"}
    step = 1.0 if kind == "int" else 0.01
    limits = {"min": low, "max": high, "step": step}
    steps = math.inf
    if default and low is not None and high is not None:
        steps = (high - low) / step
    if steps <= LARGEST_SLIDER:
        return {**made, "kind": "slider", **limits}
    # a limit of the machine, not of the thing
    if high is not None and high > MOST_SAID:
        limits["max"] = None
    return {**made, "kind": "number", **limits}


MOST_SAID = 1e6


def _as_text(value: Any) -> str:
    """As it is typed: YAML of plain data."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "as they are"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _bounds(text: str) -> tuple[float | None, float | None]:
    """The least and the greatest number of "≥ 1, ≤ 9"."""
    found = {
        sign: float(number)
        for sign, number in re.findall(r"([≥>≤<]) ?(\S+?)(?:,|$)", text)
    }
    return found.get("≥", found.get(">")), found.get("≤", found.get("<"))


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


def run_settings(draft: Draft, registry: Registry) -> dict[str, Any]:
    """The settings of a run as a draft says; raises SettingsError where they are none.

    The draft's form holds prompt, editor, reconstructor, quality and, under "settings", what was
    typed for the settings of "run", "editor NAME" and "reconstructor NAME". What is empty is left
    to the run's own defaults.
    """
    form = draft.form
    settings = _typed(form, "run")
    settings["prompt"] = str(form.get("prompt", "")).strip()
    settings["guess"] = (
        True  # the page shows what is meant, and asks, before anything is edited
    )
    usual = Draft().outline
    steps = draft.outline.items()
    settings |= {key: value for key, value in steps if value != usual[key]}
    if draft.chose:
        settings["candidate"] = draft.outline["candidate"]
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
            f"{RUNS_PROGRAMS} starts a program of your choice; only edit3r run may do that."
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
