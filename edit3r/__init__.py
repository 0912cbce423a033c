"""edit3r: edit 3D scenes from a few photos. Every stage is a plugin.

The public names below load on first use, so `import edit3r` stays cheap (no torch) and a plugin's
declaration module can import `Component` and `hookimpl` without paying for anything else.
"""

from importlib import import_module

import edit3r.moved
from edit3r.version import __version__

TYPE_CHECKING = False  # as in typing, which takes a while to import


_HOME = {
    "Component": "edit3r.contract.component",
    "hookimpl": "edit3r.contract.hookspecs",
    "Settings": "edit3r.contract.settings",
    "PartChoice": "edit3r.contract.settings",
    "Edit3rError": "edit3r.contract.errors",
    "Views": "edit3r.contract.types",
    "EditRequest": "edit3r.contract.types",
    "Cameras": "edit3r.contract.types",
    "Gaussians": "edit3r.contract.types",
    "Features": "edit3r.contract.types",
    "Reconstruction": "edit3r.contract.types",
    "Rendering": "edit3r.contract.types",
    "build": "edit3r.loading.registry",
    "components": "edit3r.loading.registry",
    "default_registry": "edit3r.loading.registry",
    "Registry": "edit3r.loading.registry",
    "load_views": "edit3r.kit.photos.images",
    "save_ply": "edit3r.kit.scenes.ply",
    "load_ply": "edit3r.kit.scenes.ply",
    "run": "edit3r.api",
    "RunResult": "edit3r.running.loop",
    "RunConfig": "edit3r.running.config",
    "Selection": "edit3r.running.selecting.select",
    "Cache": "edit3r.kit.cache",
    "select": "edit3r.running.selecting.call",
    "Command": "edit3r.contract.command",
}

__all__ = [
    "Cache",
    "Cameras",
    "Command",
    "Component",
    "Edit3rError",
    "EditRequest",
    "Features",
    "Gaussians",
    "PartChoice",
    "Reconstruction",
    "Registry",
    "Rendering",
    "RunConfig",
    "RunResult",
    "Selection",
    "Settings",
    "Views",
    "__version__",
    "build",
    "components",
    "default_registry",
    "hookimpl",
    "load_ply",
    "load_views",
    "run",
    "save_ply",
    "select",
]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'edit3r' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__


if TYPE_CHECKING:
    from edit3r.api import run
    from edit3r.contract.command import Command
    from edit3r.contract.component import Component
    from edit3r.contract.errors import Edit3rError
    from edit3r.contract.hookspecs import hookimpl
    from edit3r.contract.settings import PartChoice, Settings
    from edit3r.contract.types import (
        Cameras,
        EditRequest,
        Features,
        Gaussians,
        Reconstruction,
        Rendering,
        Views,
    )
    from edit3r.kit.cache import Cache
    from edit3r.kit.photos.images import load_views
    from edit3r.kit.scenes.ply import load_ply, save_ply
    from edit3r.loading.registry import Registry, build, components, default_registry
    from edit3r.running.config import RunConfig
    from edit3r.running.loop import RunResult
    from edit3r.running.selecting.call import select
    from edit3r.running.selecting.select import Selection
