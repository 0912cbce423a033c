"""Does a component keep what its declaration promises? Asked by `list-plugins --check`, `doctor` and contract tests."""

import inspect

from edit3r.errors import Edit3rError
from edit3r.plugins import Offer
from edit3r.registry import Registry


def check_offer(registry: Registry, offer: Offer) -> str:
    """Import the component's class and check it against its interface; '' or what is wrong in one sentence.

    A component whose requirements are not installed is not checked: `Registry.missing` tells of that.
    """
    from edit3r.interfaces import INTERFACES

    if registry.missing(offer):
        return ""
    try:
        cls = registry.load_class(offer)
        settings = registry.settings_class(offer)
    except Edit3rError as error:
        return str(error)
    interface = INTERFACES[offer.kind]
    if not (isinstance(cls, type) and issubclass(cls, interface)):
        return f"{offer.component.target} must be a subclass of edit3r.interfaces.{interface.__name__}"
    if inspect.isabstract(cls):
        left = ", ".join(sorted(cls.__abstractmethods__))
        return f"{cls.__name__} does not implement {left}"
    without = [name for name, field in settings.model_fields.items() if not field.description]
    if without:
        return f"setting {without[0]!r} of {cls.__name__} has no description"
    unfilled = [part for part in offer.component.parts if part not in settings.model_fields]
    if unfilled and offer.kind not in ("head", "trainer"):  # theirs come from the component they are built for
        return f"part {unfilled[0]!r} is declared but Settings has no field of that name to choose it"
    return ""
