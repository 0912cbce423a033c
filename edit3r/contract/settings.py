"""Settings: one small frozen class per component, from defaults, YAML files and `--set key=value`.

Every field has a default, a range and a sentence (pydantic's `Field(default, ge=...,
description=...)`); an unknown key or a value out of range is an error that names the key, the range
and what was given.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.config import JsonDict
from pydantic.fields import FieldInfo

from edit3r.contract.errors import SettingsError, did_you_mean

SettingsType = TypeVar("SettingsType", bound="Settings")


Share = Annotated[float, Field(ge=0, le=1)]
"""A number from 0 to 1."""

NonNegative = Annotated[float, Field(ge=0)]
"""A number of at least 0."""

Count = Annotated[int, Field(ge=1)]
"""A whole number of at least 1."""

Index = Annotated[int, Field(ge=0)]
"""A whole number of at least 0, such as a seed."""


class Settings(BaseModel):
    """Base of every component's settings: frozen, unknown keys refused.

    The docstring below a field, or the `description` of its `Field`, says what it is.
    """

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        arbitrary_types_allowed=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        for field in cls.model_fields.values():
            if field.description:  # on one line, whatever its docstring takes
                field.description = " ".join(field.description.split())

    @model_validator(mode="before")
    @classmethod
    def _keep_default_parts(cls, values: Any) -> Any:
        """Settings of a part without a name, as `backbone.width=64`, change the default part."""
        if not isinstance(values, Mapping):
            return values
        filled = dict(values)
        for key, given in values.items():
            if key in cls.model_fields and isinstance(given, Mapping):
                filled[key] = _over_default(cls.model_fields[key], given)
        return filled


USER_ONLY: JsonDict = {"user_only": True}
"""`json_schema_extra` of a setting that names a program, or an address that gets photos and keys.

Only the user may give it (`--set`, a flag, Python), no file that may be a stranger's.
"""


@dataclass(frozen=True)
class OfKind:
    """In `Annotated`, for schemas: the kind of a part that its setting's name does not say.

    Also of a mapping from components' names to their settings.
    """

    kind: str


@dataclass(frozen=True)
class OrCalled:
    """In `Annotated`, for schemas: a part that no plugin offers, and its settings."""

    name: str
    settings: "type[Settings]"


class FileText(str):
    """A text of a file that may be a stranger's."""


class PartChoice(Settings):
    """Which component fills a part, and its settings.

    `backbone: name` or `backbone: {name: ..., width: 128}`.
    """

    name: str
    settings: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _from_short_forms(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {"name": value}
        if isinstance(value, Mapping) and "settings" not in value:
            settings = dict(value)
            return {"name": settings.pop("name", None), "settings": settings}
        return value


def _over_default(field: FieldInfo, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """`given` over a field's default part, unless `given` names a part itself."""
    default = field.get_default(call_default_factory=True)
    if "name" in given or not isinstance(default, PartChoice):
        return given
    return merge({"name": default.name, **default.settings}, given)


def make_settings(
    cls: type[SettingsType], values: Mapping[str, Any], where: str
) -> SettingsType:
    """Validate `values` into `cls`; error sentences begin with `where`, such as 'editor'.

    Raises SettingsError for what is wrong, and for a `USER_ONLY` setting that a file brought.
    """
    for name, field in cls.model_fields.items():
        if is_user_only(field) and _is_of_file(values.get(name)):
            key = f"{where}.{name}"
            raise SettingsError(
                f"{key}: a file may not give this setting, which names a program or an address; "
                f"give it yourself (--set {key}=...), or say --trust-config."
            )
    try:
        return cls.model_validate(dict(values))
    except ValidationError as error:
        raise SettingsError(_sentence(error, cls, where)) from None


def is_user_only(field: FieldInfo) -> bool:
    """Whether a setting is one that only the user may give, see `USER_ONLY`."""
    extra = field.json_schema_extra
    return isinstance(extra, dict) and bool(extra.get("user_only"))


def _is_of_file(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_is_of_file, value))
    return isinstance(value, FileText) and value != ""


def of_file(content: Any) -> Any:
    """Mark every text in what a file holds, so that no `USER_ONLY` setting takes it."""
    if isinstance(content, str):
        return FileText(content)
    if isinstance(content, list):
        return [of_file(item) for item in content]
    if isinstance(content, Mapping):
        return {key: of_file(item) for key, item in content.items()}
    return content


def _sentence(error: ValidationError, cls: type[Settings], where: str) -> str:
    first = error.errors()[0]
    key = ".".join([where, *(str(part)[:60] for part in first["loc"])])
    if first["type"] == "extra_forbidden":
        known = sorted(cls.model_fields)
        hint = did_you_mean(str(first["loc"][-1]), known)
        listed = ", ".join(known) or "none"
        return f"{key}: unknown setting.{hint} Known settings of {where}: {listed}."
    message = first["msg"].removeprefix("Value error, ").rstrip(".")
    given = shortened(first.get("input"))
    return f"{key}: {message[0].lower()}{message[1:]}, got {given}."


def shortened(value: Any, most: int = 200) -> str:
    """A value as an error shows it: its beginning, where it is long."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # An integer of thousands of digits, a mapping nested as deep.
        return f"a {type(value).__name__} too large to show"
    return text if len(text) <= most else f"{text[:most]}..."


def merge(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Deep merge: mappings are merged key by key, anything else in `over` replaces.

    A component given by its name alone keeps it: `editor: recolor`, then `editor: {strength: 1}`.
    A mapping that names another component replaces the whole one: settings of the first mean
    nothing to the second.
    """
    result = dict(base)
    for key, value in over.items():
        before = result.get(key)
        if isinstance(value, Mapping) and isinstance(before, str):
            before = {"name": before}
        if (
            isinstance(value, Mapping)
            and isinstance(before, Mapping)
            and not _names_another(before, value)
        ):
            result[key] = merge(before, value)
        else:
            result[key] = value
    return result


def _names_another(before: Mapping[str, Any], value: Mapping[str, Any]) -> bool:
    """Whether both mappings name a component, and not the same one."""
    return {"name"} <= before.keys() & value.keys() and before["name"] != value["name"]
