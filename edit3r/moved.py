"""Modules that were promised under another name; they warn, and leave with the release after next.

`docs/plugins/api-versions.md` says how a name leaves.
"""

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module, util
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED: dict[str, tuple[str, ...]] = {
    "edit3r.config": (
        "edit3r.contract.settings",
        "edit3r.kit.files.configs",
        "edit3r.kit.files.yaml",
    ),
    "edit3r.errors": ("edit3r.contract.errors",),
    "edit3r.geometry": ("edit3r.kit.geometry",),
    "edit3r.reporting": ("edit3r.contract.reporting",),
    "edit3r.selection": ("edit3r.running.selecting",),
    "edit3r.kit.wishes": ("edit3r_language",),
    "edit3r.kit.wishes.colours": ("edit3r.kit.compute.colour_names",),
    "edit3r.kit.wishes.read": ("edit3r.running.reading",),
    "edit3r.kit.wishes.sentence": ("edit3r_language.grammar",),
    "edit3r.kit.wishes.sets": ("edit3r_language.vocabulary",),
    "edit3r.kit.wishes.vocabulary": (
        "edit3r_language.vocabulary",
        "edit3r.contract.wishes",
    ),
    "edit3r.wishes": ("edit3r_language",),
    "edit3r.wishes.colours": ("edit3r.kit.compute.colour_names",),
    "edit3r.wishes.read": ("edit3r.running.reading",),
}
"""Where the names of an old module are now; the modules inside a package moved with it."""


class MovedModules:
    """Finds the old modules, each as one that looks its names up in the new ones.

    Finder and loader in one, without their base classes: `importlib.abc` takes a while to import.
    """

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if not _homes(name):
            return None
        # Two methods are enough of a loader.
        return util.spec_from_loader(name, self, is_package=True)  # type: ignore[arg-type]

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        homes = _homes(spec.name)
        # The frames between are those of the import system.
        warnings.warn(
            f"{spec.name} is now {' and '.join(homes)}",
            DeprecationWarning,
            stacklevel=6,
        )
        return _Proxy(spec.name, homes)

    def exec_module(self, module: ModuleType) -> None:
        """There is nothing to run."""


class _Proxy(ModuleType):
    def __init__(self, name: str, homes: tuple[str, ...]) -> None:
        super().__init__(name)
        self._modules = [import_module(home) for home in homes]

    def __getattr__(self, name: str) -> object:
        # The import system asks for __path__ and the like, which are this module's own.
        modules = () if name.startswith("__") else self._modules
        for module in modules:
            if hasattr(module, name):
                return getattr(module, name)
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")


def _homes(name: str) -> tuple[str, ...]:
    """The modules that a moved one's names are in; () for one that did not move."""
    if name in MOVED:
        return MOVED[name]
    package, _, inside = name.rpartition(".")
    homes = MOVED.get(package, ())
    return (f"{homes[0]}.{inside}",) if len(homes) == 1 else ()


sys.meta_path.append(MovedModules())
