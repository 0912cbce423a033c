"""Components and their settings in words: for `edit3r describe` and the reference pages."""

import types
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import yaml
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

from edit3r.contract.component import Component, Offer
from edit3r.contract.settings import PartChoice, Settings
from edit3r.loading.registry import Registry
from edit3r.loading.schema import component_schema

BOUNDS = (
    ("ge", "≥"),
    ("gt", ">"),
    ("le", "≤"),
    ("lt", "<"),
    ("multiple_of", "multiple of"),
)
PART_KINDS = ("backbone", "head", "matcher")
"""Kinds that are keys of a reconstructor."""


@dataclass(frozen=True)
class SettingLine:
    """One setting in words."""

    name: str
    type: str  # "float", "int or null", "'a' | 'b'", "component (backbone)"
    range: str  # "≥ 0, ≤ 1"; "" where the type says it all
    default: Any
    sentence: str
    required: bool = False  # it has no default

    @property
    def allowed(self) -> str:
        """Type, range, and whether it must be given."""
        return ", ".join(
            text
            for text in (self.type, self.range, "required" if self.required else "")
            if text
        )

    @property
    def default_yaml(self) -> str:
        """The default as one line of YAML."""
        return _flow(self.default)


def settings_lines(cls: type[Settings]) -> tuple[SettingLine, ...]:
    """Every setting of a component's settings class, in the order written."""
    lines = []
    for name, field in cls.model_fields.items():
        default = (
            None
            if field.is_required()
            else field.get_default(call_default_factory=True)
        )
        words = type_in_words(field.annotation)
        sentence = (field.description or "").strip()
        lines.append(
            SettingLine(
                name,
                words,
                _range(field),
                _plain(default),
                sentence,
                field.is_required(),
            )
        )
    return tuple(lines)


def yaml_example(offer: Offer, cls: type[Settings]) -> str:
    """The component with its defaults as YAML, each setting explained in a comment."""
    rows = [(f"  name: {offer.component.name}", "")]
    for line in settings_lines(cls):
        comment = f"{line.sentence} ({line.allowed})" if line.sentence else line.allowed
        rows.append((f"  {line.name}: {line.default_yaml}", comment))
    width = min(max(len(row) for row, _ in rows), 44)
    body = [f"{row:<{width}}  # {comment}" if comment else row for row, comment in rows]
    return "\n".join(_under_its_key(offer.kind, body))


def described(registry: Registry, offer: Offer) -> dict[str, Any]:
    """A component as JSON: what its declaration says, the schema of its settings, an example."""
    cls = registry.settings_class(offer)
    return {
        "kind": offer.kind,
        "name": offer.component.name,
        "plugin": offer.plugin,
        "version": offer.version,
        "summary": offer.component.summary,
        "about": dict(metadata_lines(offer.component)),
        "settings": component_schema(registry, offer),
        "example": {
            line.name: line.default for line in settings_lines(cls) if not line.required
        },
    }


def metadata_lines(component: Component) -> tuple[tuple[str, str], ...]:
    """What a user should know before building the component, as (what, value)."""
    most = "or more" if component.max_views is None else f"to {component.max_views}"
    yes_or_no = ("no", "yes")
    lines = (
        ("writes", component.suffix and component.file_name()),
        ("keeps", component.keeps),
        ("loses", component.loses),
        ("licence", component.licence),
        ("views", f"{component.min_views} {most}"),
        ("runs on", " or ".join(component.devices) or "any device"),
        ("needs the network", yes_or_no[component.needs_network]),
        ("same seed, same result", yes_or_no[component.supports_seed]),
        ("requires", ", ".join(component.requires)),
        ("parts", ", ".join(component.parts)),
        *(
            ("weights", f"{weights.get} ({weights.terms})")
            for weights in component.weights
        ),
        ("citation", component.citation),
    )
    return tuple((what, value) for what, value in lines if value)


def type_in_words(annotation: Any) -> str:
    """A type annotation as a user would say it."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return type_in_words(arguments[0])
    if origin in (Union, types.UnionType):
        return " or ".join(type_in_words(argument) for argument in arguments)
    if origin is Literal:
        return " | ".join(_flow(argument) for argument in arguments)
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " | ".join(_flow(_plain(member)) for member in annotation)
    if origin in (tuple, list, set, frozenset) and arguments:
        kinds = list(
            dict.fromkeys(type_in_words(a) for a in arguments if a is not Ellipsis)
        )
        count = (
            f"{len(arguments)} "
            if origin is tuple and Ellipsis not in arguments
            else ""
        )
        return f"list of {count}{' or '.join(kinds)}"
    if origin is dict and arguments:
        return (
            f"mapping of {type_in_words(arguments[0])} to {type_in_words(arguments[1])}"
        )
    names = {
        type(None): "null",
        str: "text",
        bool: "true or false",
        PartChoice: "component",
        Any: "anything",
    }
    return names.get(annotation, getattr(annotation, "__name__", str(annotation)))


def _range(field: FieldInfo) -> str:
    """Bounds from pydantic's constraints."""
    bounds = [
        (sign, getattr(bound, name, None))
        for name, sign in BOUNDS
        for bound in field.metadata
    ]
    return ", ".join(f"{sign} {bound:g}" for sign, bound in bounds if bound is not None)


def _plain(value: Any) -> Any:
    """A default as YAML data."""
    if isinstance(value, PartChoice):
        return (
            {"name": value.name, **_plain(value.settings)}
            if value.settings
            else value.name
        )
    if isinstance(value, Enum):
        return _plain(value.value)
    if isinstance(value, Settings):
        return {name: _plain(getattr(value, name)) for name in type(value).model_fields}
    if isinstance(value, dict):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(inner) for inner in value]
    return to_jsonable_python(value, fallback=str)


def _flow(value: Any) -> str:
    """A value as one line of YAML."""
    text = yaml.safe_dump(
        value, default_flow_style=True, width=10**6, sort_keys=False, allow_unicode=True
    )
    return text.removesuffix("\n").removesuffix("\n...")


def _under_its_key(kind: str, body: list[str]) -> list[str]:
    """Indent below the key where a configuration chooses this kind; refiners are a list."""
    if kind == "refiner":
        return [
            "refiners:",
            body[0].replace("  ", "  - ", 1),
            *("  " + line for line in body[1:]),
        ]
    if kind in PART_KINDS:
        return ["reconstructor:", f"  {kind}:", *("  " + line for line in body)]
    return [f"{kind}:", *body]
