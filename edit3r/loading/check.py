"""Does a component keep what its declaration promises? For `--check`, `doctor`, contract tests."""

import inspect
from typing import Any

from pydantic import ValidationError

from edit3r.contract.component import Component, Offer
from edit3r.contract.errors import Edit3rError
from edit3r.contract.settings import Settings
from edit3r.loading.registry import Registry

PARTS_FROM_OUTSIDE = ("head", "trainer")
"""Kinds whose parts come from the component they are built for, so that their settings need not
choose them.
"""


def check_offer(registry: Registry, offer: Offer) -> str:
    """Check a component's class against its interface; '' or what is wrong in one sentence.

    A component whose requirements are not installed is not checked: `Registry.missing` tells of
    that.
    """
    if registry.missing(offer):
        return ""
    try:
        cls, settings = registry.load_class(offer), registry.settings_class(offer)
    except Edit3rError as error:
        return str(error)
    problem = (
        _check_declaration(offer.component)
        or _check_file(offer)
        or _check_interface(offer, cls)
        or _check_settings(cls, settings)
        or _check_parts(offer, cls, settings)
        or _check_view_limits(offer, cls)
        or _check_needs(offer, cls)
    )
    return f"{offer.kind} {offer.component.name!r}: {problem}" if problem else ""


def _check_declaration(component: Component) -> str:
    if not component.summary.strip() or "\n" in component.summary:
        return "its summary must be one line that says what it does"
    if not component.licence.strip():
        return "its licence is empty; state that of the code and of weights it brings along"
    if component.max_views is not None and component.max_views < component.min_views:
        return (
            f"max_views {component.max_views} is below min_views {component.min_views}"
        )
    return ""


def _check_file(offer: Offer) -> str:
    """A writer says what it writes, so that one can choose without trying."""
    component = offer.component
    if offer.kind != "writer":
        return ""
    if len(component.suffix) < 2 or component.suffix[0] not in ".-":
        return (
            f"its suffix is {component.suffix!r}; state how its files end, such as '.spz', or "
            "its folders, such as '-colmap'"
        )
    for field in ("keeps", "loses"):
        if not getattr(component, field).strip():
            return f"it does not say what it {field} of a scene; state {field}='...'"
    return ""


def _check_needs(offer: Offer, cls: Any) -> str:
    """A writer needs what a scene may have."""
    if offer.kind != "writer":
        return ""
    from edit3r.contract.interfaces import SceneToWrite

    known = SceneToWrite.__dataclass_fields__
    unknown = [name for name in cls.needs if name not in known]
    return (
        f"it needs {unknown[0]!r}, which no scene has; there are {', '.join(known)}"
        if unknown
        else ""
    )


def _check_interface(offer: Offer, cls: type) -> str:
    from edit3r.contract.interfaces import INTERFACES

    interface = INTERFACES[offer.kind]
    if not (isinstance(cls, type) and issubclass(cls, interface)):
        return (
            f"{offer.component.target} must be a subclass of "
            f"edit3r.contract.interfaces.{interface.__name__}"
        )
    if inspect.isabstract(cls):
        lacking = sorted(getattr(cls, "__abstractmethods__", ()))
        return f"{cls.__name__} does not implement {', '.join(lacking)}"
    return ""


def _check_settings(cls: type, settings: type[Settings]) -> str:
    without = [
        name for name, field in settings.model_fields.items() if not field.description
    ]
    if without:
        return f"setting {without[0]!r} of {cls.__name__} has no description"
    try:
        settings()
    except ValidationError as error:
        refused = [
            problem["msg"] for problem in error.errors() if problem["type"] != "missing"
        ]
        return (
            f"the defaults of its settings are refused by themselves ({refused[0]})"
            if refused
            else ""
        )
    return ""


def _check_parts(offer: Offer, cls: type, settings: type[Settings]) -> str:
    unfilled = [
        part for part in offer.component.parts if part not in settings.model_fields
    ]
    if unfilled and offer.kind not in PARTS_FROM_OUTSIDE:
        return (
            f"part {unfilled[0]!r} is declared but Settings has no field of that name to "
            "choose it"
        )
    parts = dict.fromkeys(offer.component.parts)
    try:
        inspect.signature(cls).bind(None, **parts)
    except TypeError as error:
        call = ", ".join(["settings", *(f"{part}=..." for part in parts)])
        return f"{cls.__name__}({call}) does not fit its __init__ ({error})"
    return ""


def _check_view_limits(offer: Offer, cls: Any) -> str:
    """A reconstructor says its limits twice: in its declaration, and on the class a run asks."""
    if offer.kind != "reconstructor":
        return ""
    declared = (offer.component.min_views, offer.component.max_views)
    said = (cls.min_views, cls.max_views)
    # else a property, known when built
    simple = isinstance(said[0], int) and isinstance(said[1], int | None)
    if simple and declared not in (said, (1, None)):
        return (
            f"it declares min_views, max_views = {declared}, but {cls.__name__} says "
            f"{said}; make them agree"
        )
    return ""
