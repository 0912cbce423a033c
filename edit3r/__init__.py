"""edit3r: edit 3D scenes from a few photos. Every stage is a plugin.

The public names below load on first use, so `import edit3r` stays cheap (no torch) and a plugin's
declaration module can import `Component` and `hookimpl` without paying for anything else.
"""

from importlib import import_module

TYPE_CHECKING = False  # as in typing, which takes a while to import

__version__ = "0.1.0"

_HOME = {
    "Component": "edit3r.contract.component",
    "hookimpl": "edit3r.contract.hookspecs",
    "Settings": "edit3r.config",
    "PartChoice": "edit3r.config",
    "Edit3rError": "edit3r.errors",
    "Views": "edit3r.contract.types",
    "EditRequest": "edit3r.contract.types",
    "Cameras": "edit3r.contract.types",
    "Gaussians": "edit3r.contract.types",
    "Features": "edit3r.contract.types",
    "Reconstruction": "edit3r.contract.types",
    "Rendering": "edit3r.contract.types",
    "build": "edit3r.plugins.registry",
    "components": "edit3r.plugins.registry",
    "load_views": "edit3r.io.images",
    "save_ply": "edit3r.io.ply",
    "load_ply": "edit3r.io.ply",
    "run": "edit3r.api",
    "RunResult": "edit3r.pipeline.run",
    "RunConfig": "edit3r.pipeline.config",
    "Selection": "edit3r.selection.select",
    "select": "edit3r.selection.call",
    "Cache": "edit3r.cache",
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
    "Rendering",
    "RunConfig",
    "RunResult",
    "Selection",
    "Settings",
    "Views",
    "__version__",
    "build",
    "components",
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
    from edit3r.cache import Cache
    from edit3r.config import PartChoice, Settings
    from edit3r.contract.command import Command
    from edit3r.contract.component import Component
    from edit3r.contract.hookspecs import hookimpl
    from edit3r.contract.types import (
        Cameras,
        EditRequest,
        Features,
        Gaussians,
        Reconstruction,
        Rendering,
        Views,
    )
    from edit3r.errors import Edit3rError
    from edit3r.io.images import load_views
    from edit3r.io.ply import load_ply, save_ply
    from edit3r.pipeline.config import RunConfig
    from edit3r.pipeline.run import RunResult
    from edit3r.plugins.registry import build, components
    from edit3r.selection.call import select
    from edit3r.selection.select import Selection
