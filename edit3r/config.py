"""Settings: one small frozen class per component, from defaults, YAML files and `--set key=value`.

Every field has a default, a range and a sentence (pydantic's `Field(default, ge=...,
description=...)`); an unknown key or a value out of range is an error that names the key, the range
and what was given.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

from edit3r.errors import InputError, SettingsError, suggest

SettingsType = TypeVar("SettingsType", bound="Settings")

MAX_VALUES = 100_000
"""Values in a YAML document, those that aliases repeat counted each time."""

_TEXT = "tag:yaml.org,2002:str"
_MERGE = "tag:yaml.org,2002:merge"

Share = Annotated[float, Field(ge=0, le=1)]
"""A number from 0 to 1."""

NonNegative = Annotated[float, Field(ge=0)]
"""A number of at least 0."""

Count = Annotated[int, Field(ge=1)]
"""A whole number of at least 1."""

Index = Annotated[int, Field(ge=0)]
"""A whole number of at least 0, such as a seed."""


class Settings(BaseModel):
    """Base of every component's settings: frozen, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

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


USER_ONLY = {"user_only": True}
"""`json_schema_extra` of a setting that names a program, or an address that gets photos and keys.

Only the user may give it (`--set`, a flag, Python), no file that may be a stranger's.
"""


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
        hint = suggest(str(first["loc"][-1]), known)
        listed = ", ".join(known) or "none"
        return f"{key}: unknown setting.{hint} Known settings of {where}: {listed}."
    message = first["msg"].removeprefix("Value error, ").rstrip(".")
    given = _shortened(first.get("input"))
    return f"{key}: {message[0].lower()}{message[1:]}, got {given}."


def _shortened(value: Any, most: int = 200) -> str:
    """A value as an error shows it: its beginning, where it is long."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):
        # An integer of thousands of digits, a mapping nested as deep.
        return f"a {type(value).__name__} too large to show"
    return text if len(text) <= most else f"{text[:most]}..."


def read_yaml(path: str | Path) -> dict[str, Any]:
    """Read a YAML mapping; an empty file is an empty mapping."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such configuration file.")
    try:
        content = parse_yaml(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(f"{path}: not valid YAML ({error}).") from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(
            f"{path}: expected a mapping of settings at the top, got {type(content).__name__}."
        )
    return content


def parse_yaml(text: str) -> Any:
    """Read YAML that may come from anybody: numbers, texts, lists and mappings with text as keys.

    Raises ValueError with the reason for anything else: what is no YAML, dates that do not exist,
    numbers and nestings that Python refuses, keys that are no text, more than `MAX_VALUES` values.
    """
    try:
        loader = yaml.SafeLoader(text)
        document = loader.get_single_node()
        if document is None:
            return None
        _check_node(document, {})
        return loader.construct_document(document)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except (yaml.YAMLError, ValueError, OverflowError, TypeError) as error:
        raise ValueError(" ".join(str(error).split())) from None


def _check_node(node: yaml.Node, counts: dict[yaml.Node, int]) -> int:
    """Count the values of a node, each alias as what it stands for; refuse keys that are no text.

    A node that several aliases name is visited once. `counts` holds what was visited.
    """
    if isinstance(node, yaml.ScalarNode):
        return 1
    if node not in counts:
        counts[node] = MAX_VALUES  # as long as it is not known: it may hold itself
        children = node.value
        if isinstance(node, yaml.MappingNode):
            for key, _ in node.value:
                if key.tag not in (_TEXT, _MERGE):
                    raise ValueError(
                        f"the key {_shortened(key.value)} is no text; put it in quotes"
                    )
            children = [value for _, value in node.value]
        counts[node] = 1 + sum(_check_node(child, counts) for child in children)
    if counts[node] > MAX_VALUES:
        raise ValueError(f"it holds more than {MAX_VALUES} values")
    return counts[node]


def read_config(name: str, trusted: bool) -> dict[str, Any]:
    """Read a configuration, see `find_config`.

    One that is not `trusted` gives no `USER_ONLY` setting.
    """
    content = read_yaml(find_config(name))
    return content if trusted else of_file(content)


def find_config(name: str) -> Path:
    """Path of a configuration: a file, or the name of a shipped one (without `.yaml`)."""
    given = Path(name)
    if given.is_file():
        return given
    # The checkout comes first: an editable install leaves a stale copy of configs/ inside the
    # package.
    folders = (Path(__file__).parents[1] / "configs", Path(__file__).parent / "configs")
    folder = next(filter(Path.is_dir, folders), folders[0])
    shipped = {
        file.relative_to(folder).with_suffix("").as_posix(): file
        for file in sorted(folder.rglob("*.yaml"))
    }
    if name in shipped:
        return shipped[name]
    listed = ", ".join(shipped) or "none"
    raise InputError(
        f"{name}: neither a file nor a shipped configuration.{suggest(name, shipped)} Shipped: "
        f"{listed}."
    )


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """`["editor.steps=20", ...]` to a nested mapping; values are read as YAML."""
    result: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        path = key.strip().split(".")
        if not equals or not all(path):
            raise SettingsError(
                f"--set {assignment}: expected KEY=VALUE, for example --set editor.seed=3."
            )
        try:
            value = parse_yaml(text)
        except ValueError:
            value = text
        for part in reversed(path):
            value = {part: value}
        result = merge(result, value)
    return result


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
