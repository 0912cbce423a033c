"""The plugins that installed distributions list, each distribution read in its own guard.

Any folder on `sys.path` may be half installed. What cannot be read is named with its folder, and
all else is found.
"""

import inspect
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, wraps
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType
from typing import Any

from edit3r.contract.errors import InputError, did_you_mean
from edit3r.version import __version__

GROUP = "edit3r"
FIRST_PARTY = "edit3r"
"""The distribution whose plugins keep their names, whoever else takes them."""

CHOICE = "EDIT3R_PLUGINS"
"""Environment variable: which installed plugins are loaded, see `chosen`."""

_VALUE = re.compile(r"(?P<module>[\w.]+)\s*(:\s*(?P<attribute>[\w.]+)\s*)?(\[.*\])?\s*")


@dataclass(frozen=True)
class PluginFailure:
    """A plugin, or one component of it, that could not be used, and why in one sentence."""

    plugin: str
    version: str
    reason: str


@dataclass(frozen=True)
class PluginEntry:
    """One entry point of the group: a plugin that is installed, not yet imported."""

    name: str  # what the plugin is called here, see `named`
    entry: str  # the entry point's name
    value: str  # "module" or "module:attribute"
    distribution: str
    version: str = ""
    requires: tuple[str, ...] = ()  # the distribution's requirements

    @property
    def first_party(self) -> bool:
        return self.distribution == FIRST_PARTY

    def load(self) -> ModuleType:
        """Import the module; raises ValueError with what to do where there is none."""
        refusal = _other_edit3r(self.requires)
        if refusal:
            raise ValueError(refusal)
        match = _VALUE.fullmatch(self.value)
        if match is None or match["module"].strip(".") != match["module"]:
            meant = re.sub(r"\W+", "_", self.value.split(":")[0]).strip("_")
            raise ValueError(
                f"its entry point {self.value!r} names no module; in its package write "
                f'{self.entry} = "{meant}" and install it again'
            )
        try:
            module = import_module(match["module"])
        except ModuleNotFoundError as error:
            if error.name and f"{match['module']}.".startswith(f"{error.name}."):
                raise ValueError(
                    f"its module {match['module']} is not there; install {self.distribution} "
                    f"again, or: pip uninstall {self.distribution}"
                ) from error
            raise
        for attribute in filter(None, (match["attribute"] or "").split(".")):
            module = getattr(module, attribute)
        if not isinstance(module, ModuleType):
            raise ValueError(
                f"its entry point {self.value!r} is a {type(module).__name__}, expected the "
                f'module with the hooks: {self.entry} = "{match["module"]}"'
            )
        return module


def installed() -> tuple[list[PluginEntry], list[PluginFailure], list[str]]:
    """Plugins of all distributions that can be read, folders that cannot, and remarks on names."""
    entries: dict[tuple[str, str], PluginEntry] = {}
    failures, seen = [], set()
    everything = inspect.unwrap(metadata.distributions)  # see `hide_unreadable`
    for distribution in everything():
        try:
            name = _normalised(distribution)
            if name in seen:  # an older one further down sys.path
                continue
            seen.add(name)
            for entry in _read(distribution):
                # An editable install beside its wheel lists a plugin twice.
                entries.setdefault((entry.entry, entry.value), entry)
        except Exception as error:
            failures.append(_unreadable(distribution, error))
    named, remarks = _named(entries.values())
    return _chosen(named), failures, remarks


def hide_unreadable() -> None:
    """Keep this process's libraries from falling over half-installed packages of others.

    pydantic, torch, numba and scikit-image look for plugins of their own among all distributions,
    unguarded, and would end every command; `installed` still names what is hidden. For a program's
    start, since it replaces `importlib.metadata.distributions`.
    """
    everything = metadata.distributions

    @cache
    def unreadable() -> frozenset[Path]:
        broken = []
        for distribution in everything():
            try:
                _normalised(distribution)
                distribution.entry_points  # noqa: B018
            except Exception:
                broken.append(_folder(distribution))
        return frozenset(broken)

    @wraps(everything)
    def readable(**context: Any) -> Iterator[metadata.Distribution]:
        return (d for d in everything(**context) if _folder(d) not in unreadable())

    metadata.distributions = readable


def _normalised(distribution: metadata.Distribution) -> str:
    """The distribution's name as package indexes compare it; raises ValueError without one."""
    folder = _folder(distribution)
    stem, kind = folder.stem, folder.suffix
    name = stem.partition("-")[0] if kind in (".dist-info", ".egg-info") else ""
    name = name or distribution.metadata["Name"]
    if not isinstance(name, str) or name.startswith("."):
        raise ValueError("it has no name")
    return re.sub(r"[-_.]+", "-", name).lower()


def _read(distribution: metadata.Distribution) -> Iterator[PluginEntry]:
    """The plugins that one distribution lists; raises whatever is wrong with its files."""
    if not distribution.read_text("entry_points.txt"):
        return
    points = [point for point in distribution.entry_points if point.group == GROUP]
    if not points:
        return
    name, version = distribution.metadata["Name"], distribution.version
    if not name:
        raise ValueError("its METADATA is missing or has no name")
    for point in points:
        yield PluginEntry(
            point.name,
            point.name,
            point.value,
            name,
            version or "",
            tuple(distribution.requires or ()),
        )


def _folder(distribution: metadata.Distribution) -> Path:
    return Path(str(getattr(distribution, "_path", "")))


def _unreadable(distribution: metadata.Distribution, error: Exception) -> PluginFailure:
    folder = _folder(distribution)
    kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
    if "Pair" in str(error):  # the standard library's own words for it
        kind, error = "", ValueError("a line of entry_points.txt has no '='")
    return PluginFailure(
        folder.name or "?",
        "",
        f"its folder {folder} cannot be read ({kind}{' '.join(str(error).split())}); install that "
        "package again, or delete the folder",
    )


def _named(entries: Iterable[PluginEntry]) -> tuple[list[PluginEntry], list[str]]:
    """Every entry under a name of its own, ours first, and a sentence for each that lost its own.

    A name that is taken gives way to the distribution's, and that to both.
    """
    order = sorted(entries, key=lambda e: (not e.first_party, e.entry, e.distribution))
    owners: dict[str, str] = {}
    named, remarks = [], []
    for entry in order:
        ways = (entry.entry, entry.distribution, f"{entry.distribution}-{entry.entry}")
        name = next(way for way in (*ways, entry.value) if way not in owners)
        owners[name] = entry.distribution
        named.append(replace(entry, name=name))
        if name != entry.entry:
            remarks.append(
                f"plugin {entry.entry!r} of {entry.distribution} is called {name!r} here, because "
                f"{owners[entry.entry]} has a plugin of that name"
            )
    return sorted(named, key=lambda e: e.name), remarks


def _chosen(entries: list[PluginEntry]) -> list[PluginEntry]:
    """Those that the environment variable `EDIT3R_PLUGINS` names, all without it.

    "none": edit3r's own alone; "sepia,lamp": edit3r's own and these; "-sepia": all but this one.
    Names are those of `edit3r list-plugins`, or of distributions.
    """
    wanted = [one.strip() for one in os.environ.get(CHOICE, "").split(",")]
    wanted = [one for one in wanted if one]
    known = {one for entry in entries for one in (entry.name, entry.distribution)}
    for name in wanted:
        if name != "none" and name.removeprefix("-") not in known:
            raise InputError(
                f"{CHOICE}={os.environ[CHOICE]}: no plugin {name.removeprefix('-')!r} is "
                f"installed.{did_you_mean(name.removeprefix('-'), sorted(known))} Give 'none', "
                "names of plugins to load, or names with a dash before them to leave out."
            )
    off = {one[1:] for one in wanted if one.startswith("-")}
    on = {one for one in wanted if not one.startswith("-")}
    return [
        entry
        for entry in entries
        if not {entry.name, entry.distribution} & off
        and (not on or entry.first_party or {entry.name, entry.distribution} & on)
    ]


def _other_edit3r(requires: tuple[str, ...]) -> str:
    """Why this edit3r is not the one that a package's requirements ask for; "" where it is."""
    stated = [one for one in requires if re.match(r"edit3r\b(?!-)", one)]
    if not any(character in "".join(stated) for character in "<>=~!"):
        return ""
    from packaging.requirements import Requirement

    for requirement in map(Requirement, stated):
        applies = requirement.marker is None or requirement.marker.evaluate(
            {"extra": ""}
        )
        if applies and not requirement.specifier.contains(
            __version__, prereleases=True
        ):
            return (
                f"needs edit3r {requirement.specifier}, and {__version__} is installed; install "
                f'with: pip install "edit3r{requirement.specifier}", or another version of the '
                "plugin"
            )
    return ""
