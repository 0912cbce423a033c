"""Whether settings from a data file are ones that a run and its components take."""

from edit3r.config import make_settings
from edit3r.registry import default_registry
from edit3r.run_config import PART_KEYS, make_run_config


def check_run_settings(settings):
    """Raises SettingsError or UnknownComponentError for anything that is not known or out of range."""
    config, registry = make_run_config(settings), default_registry()
    for kind in PART_KEYS:
        choice = getattr(config, kind)
        if choice is None:
            continue
        offer = registry.find(kind, choice.name)
        made = make_settings(registry.settings_class(offer), choice.settings, kind)
        for part in offer.component.parts:
            inner = getattr(made, part)
            make_settings(registry.settings_class(registry.find(part, inner.name)), inner.settings, part)
