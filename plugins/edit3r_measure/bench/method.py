"""What is compared: an editor with a reconstructor, and how they are run. Read from flags or from a configuration."""

import re
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, field_validator, model_validator

from edit3r.config import PartChoice, Settings, make_settings, merge
from edit3r.errors import SettingsError

__all__ = ["InstrumentSettings", "Method", "read_methods"]

LABEL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]*")


class Method(Settings):
    """One column of the comparison."""

    label: str = Field("", description="name of the column and of its folder; default: editor and reconstructor")
    editor: PartChoice = Field(PartChoice(name="oracle"), description="2D editor; 'oracle' is the offline stand-in")
    reconstructor: PartChoice = Field(PartChoice(name="edit3r"), description="reconstructor")
    rasterizer: PartChoice = Field(PartChoice(name="auto"), description="draws the pictures that are measured")
    edit_views: Literal["all", "first"] = Field("all", description="edit every view, or the reference only")
    poses: bool = Field(True, description="hand true poses to reconstructors that read them, where they are known")
    truth: bool | None = Field(
        None, description="judge by the edited truth where it is known; default: for the oracle, whose edit it is"
    )
    note: str = Field("", description="what a reader of the table must know about this column")

    @field_validator("label")
    @classmethod
    def _usable_as_a_folder(cls, value: str) -> str:
        if value and not LABEL.fullmatch(value):
            raise ValueError("must be letters, digits, blanks, dots, dashes, plus signs and underscores")
        return value

    @model_validator(mode="before")
    @classmethod
    def _label_by_default(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and not values.get("label"):
            names = [_name_of(values.get(key), default) for key, default in _DEFAULTS.items()]
            return {**values, "label": "+".join(names)}
        return values


class InstrumentSettings(Settings):
    """Networks for metrics; what is not given is not measured."""

    effnet: bool = Field(True, description="C-FID and C-KID variants on EfficientNet features; needs the extra train")
    inception: str = Field("", description="TorchScript file inception-2015-12-05.pt for C-FID and C-KID; '': without")
    clip: str = Field("", description="CLIP model or folder for t2i and direction; '': without")
    lpips: bool = Field(False, description="LPIPS against the truth; needs the extra lpips")


def read_methods(
    values: Mapping[str, Any], changes: Mapping[str, Mapping[str, Any]] | None = None
) -> tuple[Method, ...]:
    """The `methods` of a configuration; `changes` are settings by label. Labels must differ."""
    entries = values.get("methods")
    if set(values) - {"methods"} or not isinstance(entries, list) or not entries:
        raise SettingsError("a benchmark configuration has one key, 'methods', with a list of at least one method.")
    methods = tuple(make_settings(Method, entry, where=f"methods.{index}") for index, entry in enumerate(entries))
    labels = [method.label for method in methods]
    twice = next((label for label in labels if labels.count(label) > 1), None)
    if twice is not None:
        raise SettingsError(f"methods: two are called {twice!r}; give each its own label.")
    unknown = sorted(set(changes or {}) - set(labels))
    if unknown:
        raise SettingsError(f"--set {unknown[0]}: no such method in the configuration; it has {', '.join(labels)}.")
    return tuple(_changed(method, (changes or {}).get(method.label, {})) for method in methods)


def _changed(method: Method, change: Mapping[str, Any]) -> Method:
    """`method` with settings laid over; a component given by another name starts without the old one's settings."""
    if not change:
        return method
    values = method.model_dump()
    for key, value in change.items():
        choice = isinstance(value, Mapping) and isinstance(values.get(key), Mapping)
        values[key] = merge(values[key], _settings_of(value)) if choice else value
    return make_settings(Method, values, where=method.label)


def _settings_of(choice: Mapping[str, Any]) -> dict[str, Any]:
    """`{name: ..., width: 3}` as `{name: ..., settings: {width: 3}}`."""
    named = {"name": choice["name"]} if "name" in choice else {}
    return {**named, "settings": {key: value for key, value in choice.items() if key != "name"}}


_DEFAULTS = {"editor": "oracle", "reconstructor": "edit3r"}


def _name_of(choice: Any, default: str) -> str:
    if choice is None:
        return default
    if isinstance(choice, Mapping):
        return str(choice.get("name", default))
    return getattr(choice, "name", str(choice)).replace(":", "-")
