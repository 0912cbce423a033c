"""Find installed plugins and ask each what it offers, each in its own guard.

Whatever one plugin does (fail on import, misspell a hook, call `sys.exit`, offer something that is
no Component, be written for another API version), it becomes one `PluginFailure` with its reason,
and every other plugin still works.
"""

import importlib.util
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import ModuleType

import pluggy

from edit3r.contract import hookspecs
from edit3r.contract.component import KINDS, Component, Offer, hook_name
from edit3r.contract.errors import InputError, did_you_mean, one_line
from edit3r.loading.entry_points import GROUP, PluginFailure, installed


@dataclass(frozen=True)
class LoadedPlugins:
    """The components of all plugins that loaded, and why the others did not."""

    offers: tuple[Offer, ...]
    failures: tuple[PluginFailure, ...]
    remarks: tuple[str, ...] = ()  # on names that were taken, a sentence each


def load_plugins(local_files: Iterable[str | Path] = ()) -> LoadedPlugins:
    """Load every installed plugin, and local files or folders (`--plugin path/to/file.py`).

    The environment variable `EDIT3R_PLUGINS` leaves installed ones out
    (`loading.entry_points`).
    """
    manager = pluggy.PluginManager(GROUP)
    manager.add_hookspecs(hookspecs)
    offers: list[Offer] = []
    entries, unreadable, remarks = installed()
    failures = list(unreadable)
    first_party = {entry.name for entry in entries if entry.first_party}
    loaders = [(entry.name, entry.version, entry.load) for entry in entries]
    for name, version, load in [*loaders, *_local(local_files)]:
        try:
            with _output_as_remarks():
                module = load()
            offers += [
                replace(offer, first_party=version != "" and name in first_party)
                for offer in _offers(manager, name, version, module)
            ]
        except KeyboardInterrupt:
            raise
        except (
            BaseException
        ) as error:  # sys.exit and pytest.skip at module level are no Exceptions
            failures.append(PluginFailure(name, version, _reason(error)))
    return LoadedPlugins(tuple(offers), tuple(failures), tuple(remarks))


@contextmanager
def _output_as_remarks() -> Iterator[None]:
    """Lead what an imported module prints to standard error: programs read standard output."""
    sys.stdout.flush()
    kept = None
    with suppress(OSError):  # closed streams
        kept = os.dup(1)
        os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        if kept is not None:
            os.dup2(kept, 1)
            os.close(kept)


def _local(
    files: Iterable[str | Path],
) -> Iterator[tuple[str, str, Callable[[], ModuleType]]]:
    for file in files:
        name, source = local_module(file)
        yield (name, "", partial(_import_file, name, source))


def local_module(file: str | Path) -> tuple[str, Path]:
    """Name and file of a local plugin: a module, a package's folder, or one that holds a single
    package, as `edit3r new-plugin` makes it. Raises InputError where there is none.
    """
    path = Path(file).resolve()
    if path.is_dir() and not (path / "__init__.py").is_file():
        inside = [one.parent for one in path.glob("*/__init__.py")]
        inside += [one.parent for one in path.glob("src/*/__init__.py")]
        packages = [one for one in inside if one.name != "tests"]
        if len(packages) > 1:
            listed = ", ".join(sorted(str(Path(file) / one.name) for one in packages))
            raise InputError(
                f"--plugin {file}: holds several packages; give one: {listed}."
            )
        path = packages[0] if packages else path
    source = path / "__init__.py" if path.is_dir() else path
    if not source.is_file():
        raise InputError(
            f"--plugin {file}: no such file; expected a Python module with edit3r hooks, or "
            "a package's folder."
        )
    return path.stem, source


def _import_file(name: str, path: Path) -> ModuleType:
    """Import a local module under its own name, so that `target="<stem>:Class"` finds it."""
    folders = [str(path.parent)] if path.name == "__init__.py" else None
    spec = importlib.util.spec_from_file_location(
        name, path, submodule_search_locations=folders
    )
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python module")
    if name in sys.modules:
        if getattr(sys.modules[name], "__file__", None) == str(path):
            return sys.modules[name]
        raise ValueError(
            f"a module named {name!r} is already imported from elsewhere; rename {path.name}"
        )
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _offers(
    manager: pluggy.PluginManager, name: str, version: str, module: ModuleType
) -> list[Offer]:
    """Register one plugin and collect what it offers; raises with the reason where it is off."""
    if manager.is_registered(module):  # a local file that is installed too
        return []
    _check_api(getattr(module, "EDIT3R_API", hookspecs.API_VERSION))
    manager.register(module, name)
    try:
        _refuse_unknown_hooks(manager, module)
        declared_in = getattr(module, "__name__", "")
        offers = [
            Offer(kind, component, name, version, declared_in)
            for kind in KINDS
            for component in _ask(manager, module, kind, name)
        ]
        if not offers:
            hooks = ", ".join(hook_name(kind) for kind in KINDS[:3])
            raise ValueError(
                "offers nothing: no function marked @edit3r.hookimpl returned a Component "
                f"({hooks}, ...)"
            )
        return offers
    except BaseException:
        manager.unregister(module)
        raise


def _check_api(api: object) -> None:
    """Raise ValueError for another API version than this edit3r's."""
    now = hookspecs.API_VERSION
    if not isinstance(api, int) or isinstance(api, bool):
        raise ValueError(
            f"EDIT3R_API must be a whole number such as {now}, got {api!r}"
        )
    if api != now:
        newer = "edit3r" if api > now else "version of the plugin"
        raise ValueError(
            f"written for edit3r API {api}, this edit3r has API {now}; install a newer {newer}"
        )


def _refuse_unknown_hooks(manager: pluggy.PluginManager, module: ModuleType) -> None:
    known = [hook_name(kind) for kind in KINDS]
    for attribute in dir(module):
        marked = manager.parse_hookimpl_opts(module, attribute) is not None
        if attribute not in known and (marked or attribute.startswith("register_")):
            meant = did_you_mean(attribute, known)
            if marked or meant:
                raise ValueError(f"{attribute!r} is not an edit3r hook.{meant}")
        if attribute in known and not marked:
            raise ValueError(
                f"{attribute} is not marked; put @edit3r.hookimpl above it"
            )


def _ask(
    manager: pluggy.PluginManager, module: ModuleType, kind: str, name: str
) -> list[Component]:
    """This plugin's answer to the hook of one kind."""
    hook = hook_name(kind)
    others = [plugin for plugin in manager.get_plugins() if plugin is not module]
    answers = manager.subset_hook_caller(hook, others)()
    listed = [
        (answer,) if isinstance(answer, Component) else answer for answer in answers
    ]
    if not all(isinstance(answer, Iterable) for answer in listed):
        raise TypeError(
            f"{hook} returned {type(listed[0]).__name__}, expected a list of edit3r.Component"
        )
    components = [component for answer in listed for component in answer]
    for component in components:
        if not isinstance(component, Component):
            raise TypeError(
                f"{hook} returned {type(component).__name__} {component!r}, expected "
                "edit3r.Component"
            )
    names = [component.name for component in components]
    double = next((n for n in names if names.count(n) > 1), None)
    if double is not None:
        raise ValueError(f"{hook} offers {double!r} twice")
    return components


def _reason(error: BaseException) -> str:
    if isinstance(error, SystemExit):
        return f"called sys.exit({error.code!r}) while loading"
    text = one_line(error)
    if isinstance(error, ModuleNotFoundError) and error.name:
        advice = (
            f"import {error.name!r} in the component's module and list it in requires"
        )
        return (
            f"ModuleNotFoundError: {text}; a declaration imports only edit3r, {advice}"
        )
    return (
        text
        if isinstance(error, ValueError | TypeError) and text
        else f"{type(error).__name__}: {text}"
    )
