"""What everything that the registry builds has in common."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from edit3r.contract.settings import Settings

if TYPE_CHECKING:
    from edit3r.contract.component import Offer


class Configured:
    """A component: its settings, where it comes from, and the parts it was built with.

    The registry constructs it as `Class(settings, **parts)` and then sets the three attributes.
    """

    settings: Settings
    offer: "Offer"
    parts: Mapping[str, Any]  # by kind

    def __init__(self, settings: Settings | None = None) -> None:
        super().__init__()
        if settings is not None:  # a network calls this without any, and sets its own
            self.settings = settings
