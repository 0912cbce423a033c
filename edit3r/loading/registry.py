"""Look components up by name, explain misses and clashes, and build them with their parts.

A component's class has a nested `Settings` (see `edit3r.contract.settings`) and is constructed as
`Class(settings, **parts)`. For a component declared with `parts=("backbone", "head")` the registry
builds those first and passes them in; which component fills a part is a setting of the same name (a
`PartChoice`), so any backbone goes with any head and no plugin looks anything up. A part that
itself names a part already built beside it (a head that needs the backbone's widths) is given that
same object.
"""

import importlib
import importlib.util
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from edit3r.contract.component import KINDS, Component, Offer
from edit3r.contract.errors import (
    Edit3rError,
    MissingDependencyError,
    PluginError,
    UnknownComponentError,
    did_you_mean,
    is_out_of_memory,
    one_line,
)
from edit3r.contract.reporting import warn
from edit3r.contract.settings import PartChoice, Settings, make_settings
from edit3r.contract.torch_state import in_usual_torch
from edit3r.contract.weights import Weights
from edit3r.kit.weights.find import at_hand
from edit3r.loading.load import (
    LoadedPlugins,
    PluginFailure,
    load_plugins,
    local_module,
)

SEVERAL = ("writer",)
"""Kinds of which a run has several, so that settings name the component: writer.gif.width."""


def _key(kind: str, name: str) -> str:
    """Where the settings of a chosen component stand in a configuration."""
    return f"{kind}.{name}" if kind in SEVERAL else kind


class Registry:
    """All components on offer."""

    def __init__(self, plugins: LoadedPlugins) -> None:
        self.plugins = plugins

    @property
    def failures(self) -> tuple[PluginFailure, ...]:
        return self.plugins.failures

    def offers(self, kind: str | None = None) -> list[Offer]:
        """Offers of one kind (all kinds by default), sorted by kind, name and plugin."""
        if kind not in (None, *KINDS):
            raise UnknownComponentError(
                f"no kind {kind!r}.{did_you_mean(kind, KINDS)} Kinds: {', '.join(KINDS)}."
            )
        chosen = [offer for offer in self.plugins.offers if kind in (None, offer.kind)]
        return sorted(
            chosen, key=lambda o: (KINDS.index(o.kind), o.component.name, o.plugin)
        )

    def clashes(self) -> list[str]:
        """A sentence for each name that several plugins offer, or that several plugins have."""
        groups: dict[tuple[str, str], list[Offer]] = {}
        for offer in self.offers():
            groups.setdefault((offer.kind, offer.component.name), []).append(offer)
        return [
            *self.plugins.remarks,
            *(
                f"{kind} {name!r} is offered by {' and '.join(o.plugin for o in group)}; "
                f"ask for {' or '.join(o.qualified_name for o in group)}"
                + (
                    "; without a plugin's name it is edit3r's own"
                    if _own(group)
                    else ""
                )
                for (kind, name), group in groups.items()
                if len(group) > 1
            ),
        ]

    def find(self, kind: str, name: str) -> Offer:
        """The offer called `name` or `plugin:name`; else UnknownComponentError.

        A name that edit3r's own component has is that one's, whatever is installed beside it; a
        local file that offers it too was named by the user, who is asked which.
        """
        offers = self.offers(kind)
        called_so = [
            offer
            for offer in offers
            if name in (offer.component.name, offer.qualified_name)
        ]
        if len(called_so) == 1:
            return called_so[0]
        if own := _own(called_so):
            return own
        if called_so:
            ways = " or ".join(repr(offer.qualified_name) for offer in called_so)
            raise UnknownComponentError(
                f"{kind} {name!r} is offered by {len(called_so)} plugins; ask for {ways}."
            )
        known = [offer.component.name for offer in offers]
        if not known:
            raise UnknownComponentError(
                f"no {kind} named {name!r}: no installed plugin offers any {kind}.{self.failed()} "
                "Install edit3r again (pip install --force-reinstall edit3r; in a checkout "
                "pip install -e .), or a plugin that has one."
            )
        listed = ", ".join(dict.fromkeys(known))
        raise UnknownComponentError(
            f"no {kind} named {name!r}.{did_you_mean(name, known)} Installed: {listed}."
            f"{self.failed()}"
        )

    def failed(self) -> str:
        """A sentence for each plugin that did not load, as the end of an error."""
        sentences = (
            f" Plugin {failure.plugin!r} did not load: {failure.reason}."
            for failure in self.failures
        )
        return "".join(sentences)

    def missing(self, offer: Offer) -> tuple[str, ...]:
        """The modules the component requires that are not installed."""
        return tuple(
            module for module in offer.component.requires if not _installed(module)
        )

    def ready(self, kind: str, name: str, *weights: str) -> bool:
        """Whether a component is installed, with any of its weights called so at hand."""
        offer = self.find(kind, name)
        return not self.missing(offer) and any(
            at_hand(w) for w in offer.component.weights if w.name in weights
        )

    def load_class(self, offer: Offer) -> type:
        """Import the component's class; raises MissingDependencyError or PluginError."""
        missing = self.missing(offer)
        absent = absent_device(offer.component) if missing else ""
        if absent:
            raise MissingDependencyError(
                f"{offer.kind} {offer.component.name!r} runs on {absent}, and this machine has no "
                f"such device; choose another (edit3r list-plugins --kind {offer.kind})."
            )
        if missing:
            raise MissingDependencyError(
                f"{offer.kind} {offer.component.name!r} needs {', '.join(missing)}; "
                f"{install_hint(offer)}"
            )
        module, _, attribute = offer.component.target.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (Exception, SystemExit) as error:
            reason = one_line(error)
            lacking = error.name if isinstance(error, ModuleNotFoundError) else None
            advice = (
                f" Install {lacking!r}; the plugin should list it in requires."
                if lacking
                else ""
            )
            raise PluginError(
                f"{offer.kind} {offer.component.name!r} of plugin {offer.plugin!r} could not be "
                "imported from "
                f"{offer.component.target!r} ({type(error).__name__}: {reason}).{advice}"
            ) from error

    def settings_class(self, offer: Offer) -> type[Settings]:
        """The component's settings class; one without any gets an empty one."""
        cls = getattr(self.load_class(offer), "Settings", Settings)
        if not (isinstance(cls, type) and issubclass(cls, Settings)):
            raise PluginError(
                f"{offer.kind} {offer.component.name!r}: its Settings must subclass "
                "edit3r.Settings."
            )
        return cls

    def build(
        self,
        kind: str,
        name: str,
        /,
        parts: Mapping[str, Any] | None = None,
        **settings: Any,
    ) -> Any:
        """Build a component by name from settings.

        `parts` fills parts with objects already built, or with names or `PartChoice`s that override
        the settings'. The result carries what it was built from as `.settings`, `.offer` and
        `.parts`.
        """
        choice = PartChoice(name=name, settings=settings)
        return self._build(kind, choice, parts or {}, {}, where=kind)

    def build_choice(
        self, kind: str, choice: PartChoice, parts: Mapping[str, Any] | None = None
    ) -> Any:
        """Build the component that a configuration chose; its settings may have any names."""
        return self._build(kind, choice, parts or {}, {}, _key(kind, choice.name))

    def build_at(self, where: str, kind: str, choice: PartChoice) -> Any:
        """The same where its key in the configuration, `where`, is not the kind's own."""
        return self._build(kind, choice, {}, {}, where)

    def check(self, kind: str, choice: PartChoice) -> Settings:
        """The settings; raises what building the component would raise about its name and them."""
        cls = self.settings_class(self.find(kind, choice.name))
        return make_settings(cls, choice.settings, _key(kind, choice.name))

    @in_usual_torch
    def _build(
        self,
        kind: str,
        choice: PartChoice,
        given: Mapping[str, Any],
        built: Mapping[str, Any],
        where: str,
    ) -> Any:
        """`where` is this component's key in a configuration, such as 'reconstructor.backbone'."""
        offer = self.find(kind, choice.name)
        cls = self.load_class(offer)
        settings = make_settings(self.settings_class(offer), choice.settings, where)
        siblings = dict(built)
        parts: dict[str, Any] = {}
        for part in offer.component.parts:
            parts[part] = siblings[part] = self._part(
                offer, settings, part, given, siblings, f"{where}.{part}"
            )
        try:
            component = cls(settings, **parts)
        except Edit3rError:
            raise
        except Exception as error:
            if is_out_of_memory(error):
                raise
            call = ", ".join(["settings", *(f"{part}=..." for part in parts)])
            raise PluginError(
                f"{kind} {offer.component.name!r} of plugin {offer.plugin!r} could not be "
                f"constructed as {cls.__name__}({call}) ({type(error).__name__}: {error})."
            ) from error
        component.settings, component.offer, component.parts = settings, offer, parts
        return component

    def _part(
        self,
        offer: Offer,
        settings: Settings,
        part: str,
        given: Mapping[str, Any],
        siblings: Mapping[str, Any],
        where: str,
    ) -> Any:
        choice = given.get(part, siblings.get(part, getattr(settings, part, None)))
        if choice is None:
            raise PluginError(
                f"{offer.kind} {offer.component.name!r} needs a {part}; neither its settings nor "
                "the caller name one."
            )
        if isinstance(choice, str | Mapping):
            choice = PartChoice.model_validate(choice)
        if not isinstance(choice, PartChoice):
            return choice
        return self._build(part, choice, given, siblings, where)


def _own(offers: list[Offer]) -> Offer | None:
    """edit3r's own of several offers of one name; None where a local file is among them."""
    local = any(not offer.version and not offer.first_party for offer in offers)
    own = [offer for offer in offers if offer.first_party]
    return own[0] if own and not local else None


def absent_device(component: Component) -> str:
    """The types of device that a component needs, where this machine has none of them; else ""."""
    import torch

    here = {"cpu"}
    if torch.cuda.is_available():
        here.add("cuda")
    if torch.backends.mps.is_available():
        here.add("mps")
    needed = component.devices
    return " or ".join(needed) if needed and not here & set(needed) else ""


def install_hint(offer: Offer) -> str:
    """The command that brings what the component requires."""
    if not offer.component.extra:
        return f"install with: pip install {' '.join(offer.component.requires)}"
    name = offer.component.extra
    if name.startswith("-"):
        return f"install with: pip install {name}"
    return (
        f"install with: pip install {name!r}"
        if "[" in name
        else f'install with: pip install "edit3r[{name}]"'
    )


def _installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except Exception:  # looking for a.b imports a, which may be broken in its own way
        return False


def default_registry(local_files: Iterable[str | Path] = ()) -> Registry:
    """The registry of everything installed and of local files, loaded once per process."""
    return _loaded(tuple(local_files))


@cache
def _loaded(local_files: tuple[str | Path, ...]) -> Registry:
    registry = Registry(load_plugins(local_files))
    named = {local_module(file)[0]: file for file in local_files}
    for failure in registry.failures:
        if failure.plugin in named and not failure.version:
            file = named[failure.plugin]
            warn(f"--plugin {file} did not load, and is not used: {failure.reason}.")
    return registry


def build(
    kind: str, name: str, /, parts: Mapping[str, Any] | None = None, **settings: Any
) -> Any:
    """Build an installed component: `edit3r.build("rasterizer", "numba", near_plane=0.01)`."""
    return default_registry().build(kind, name, parts, **settings)


def components(kind: str | None = None) -> list[Offer]:
    """What is available of one kind, or of all, without importing any of it."""
    return default_registry().offers(kind)


def declared(local_files: tuple[str, ...] = ()) -> dict[str, Weights]:
    """All weights that installed components name, by name; those of plugins in local files too."""

    by_name: dict[str, Weights] = {}
    for offer in default_registry(local_files).offers():
        for weights in offer.component.weights:
            by_name.setdefault(weights.name, weights)
    return dict(sorted(by_name.items()))
