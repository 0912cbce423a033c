"""JSON schemas of components' settings and of configuration files, for editors and forms.

Settings classes give theirs by pydantic. What it cannot know is added here: which installed
components fill a part, and their settings.
"""

from collections.abc import Iterator, Mapping
from typing import Any, get_args

from pydantic.fields import FieldInfo

from edit3r.contract.component import KINDS, Offer
from edit3r.contract.errors import Edit3rError
from edit3r.contract.settings import OfKind, OrCalled, PartChoice, Settings
from edit3r.loading.registry import Registry

DIALECT = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]


def component_schema(registry: Registry, offer: Offer) -> Schema:
    """The schema of one component's settings, as `edit3r.build` takes them."""
    builder = _Builder(registry)
    schema = builder.settings(registry.settings_class(offer))
    return builder.whole(schema, f"{offer.kind} {offer.component.name}")


def configuration_schema(
    registry: Registry,
    cls: type[Settings],
    title: str,
    others: Mapping[str, type[Settings]] | None = None,
) -> Schema:
    """The schema of a configuration file with the settings of all installed components.

    `others`: further settings that a field may hold whole, by the name it gives in `OfKind`.
    """
    builder = _Builder(registry, others or {})
    return builder.whole(builder.settings(cls), title)


class _Builder:
    """Schemas of settings; those of each kind of component stand once, under `$defs`."""

    def __init__(
        self, registry: Registry, others: Mapping[str, type[Settings]] | None = None
    ) -> None:
        self.registry = registry
        self.others = others or {}
        self.definitions: dict[str, Schema] = {}

    def whole(self, schema: Schema, title: str) -> Schema:
        return {
            "$schema": DIALECT,
            "title": title,
            **schema,
            "$defs": self.definitions,
        }

    def settings(self, cls: type[Settings]) -> Schema:
        """An object with one property for each setting, and no others."""
        own = (
            f"{cls.__module__}.{cls.__qualname__}."  # two may have a class of one name
        )
        plain = cls.model_json_schema(ref_template=f"#/$defs/{own}{{model}}")
        nested = {one.__name__: one for one in _nested(cls)}
        for name, definition in plain.get("$defs", {}).items():
            inner = nested.get(name)
            self.definitions[own + name] = (
                definition if inner is None else self.settings(inner)
            )
        properties = {
            name: self._property(name, field, plain["properties"][name])
            for name, field in cls.model_fields.items()
        }
        schema = {"type": "object", "properties": properties}
        if plain.get("required"):
            schema["required"] = plain["required"]
        return {**schema, "additionalProperties": False}

    def _property(self, name: str, field: FieldInfo, plain: Schema) -> Schema:
        about: Schema = {
            key: plain[key] for key in ("description", "default") if key in plain
        }
        kinds = [one.kind for one in field.metadata if isinstance(one, OfKind)]
        text = str(field.annotation)
        if PartChoice.__name__ not in text:
            if not kinds:
                return plain
            known = self._whole if kinds[0] in self.others else self._by_name
            return {**about, **known(kinds[0])}
        choice = self._choice((kinds or [name.removesuffix("s")])[0])
        for other in field.metadata:
            if isinstance(other, OrCalled):
                called = self._with_name((other.name,), self.settings(other.settings))
                choice = {"anyOf": [choice, {"const": other.name}, called]}
        if "tuple[" in text:
            return {**about, "type": "array", "items": choice}
        if "None" in text:
            choice = {"anyOf": [choice, {"type": "null"}]}
        return {**about, **choice}

    def _choice(self, kind: str) -> Schema:
        """A component of a kind, by its name or as a mapping with its settings."""
        if kind not in KINDS:
            return {"type": ["string", "object"]}
        if kind not in self.definitions:
            self.definitions[kind] = {}  # a part may have a part of its own kind
            offers = self.registry.offers(kind)
            self.definitions[kind] = {
                "anyOf": [
                    {"enum": [name for offer in offers for name in _names(offer)]},
                    *map(self._offered, offers),
                ]
            }
        return {"$ref": f"#/$defs/{kind}"}

    def _offered(self, offer: Offer) -> Schema:
        """A component as a mapping of its settings, its name among them."""
        about: Schema = {"description": offer.component.summary}
        try:
            schema = self.settings(self.registry.settings_class(offer))
        except Edit3rError:  # what it needs is not installed: any setting may be right
            properties = {"name": {"enum": list(_names(offer))}}
            bare: Schema = {"type": "object", "properties": properties}
            return {**about, **bare, "required": ["name"]}
        return {**about, **self._with_name(_names(offer), schema)}

    def _with_name(self, names: tuple[str, ...], schema: Schema) -> Schema:
        """The settings of a part with its name; a default part may have what is required."""
        properties = {"name": {"enum": list(names)}, **schema["properties"]}
        rest = {key: schema[key] for key in schema if key != "required"}
        return {**rest, "properties": properties}

    def _whole(self, name: str) -> Schema:
        if name not in self.definitions:
            self.definitions[name] = {}
            self.definitions[name] = self.settings(self.others[name])
        return {"$ref": f"#/$defs/{name}"}

    def _by_name(self, kind: str) -> Schema:
        """A mapping of components' names to their settings."""
        properties: Schema = {}
        for offer in self.registry.offers(kind):
            schema = self._offered(offer)
            schema["properties"].pop("name")
            schema.pop("required", None)
            if kind == "loss":
                schema["properties"]["weight"] = {"type": "number", "minimum": 0}
            properties |= dict.fromkeys(_names(offer), schema)
        return {
            "type": "object",
            "properties": properties,
            "additionalProperties": False,
        }


def _nested(cls: type[Settings]) -> Iterator[type[Settings]]:
    """Settings classes inside the types of a class's fields."""
    waiting = [field.annotation for field in cls.model_fields.values()]
    while waiting:
        one = waiting.pop()
        waiting += get_args(one)
        if isinstance(one, type) and issubclass(one, Settings) and one != PartChoice:
            yield one


def _names(offer: Offer) -> tuple[str, str]:
    return offer.component.name, offer.qualified_name
