"""Installed plugins: found, described, checked.

A name here is promised; the modules behind may change. Each loads on first use.
"""

from importlib import import_module

TYPE_CHECKING = False  # as in typing, which takes a while to import

_HOME = {
    "check_offer": "edit3r.loading.check",
    "SettingLine": "edit3r.loading.describe",
    "settings_lines": "edit3r.loading.describe",
    "load_plugins": "edit3r.loading.load",
    "absent_device": "edit3r.loading.registry",
    "install_hint": "edit3r.loading.registry",
    "declared": "edit3r.loading.weights",
}

__all__ = [
    "SettingLine",
    "absent_device",
    "check_offer",
    "declared",
    "install_hint",
    "load_plugins",
    "settings_lines",
]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'edit3r.loading' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


if TYPE_CHECKING:
    from edit3r.loading.check import check_offer
    from edit3r.loading.describe import SettingLine, settings_lines
    from edit3r.loading.load import load_plugins
    from edit3r.loading.registry import absent_device, install_hint
    from edit3r.loading.weights import declared
