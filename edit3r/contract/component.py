"""What a plugin says about each thing it offers, readable without importing the thing itself, and
what all of these have in common once they are built.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from edit3r.contract.weights import Weights, check_declared, check_name

# it takes a tenth of a second to import, and declarations need none of it
if TYPE_CHECKING:
    from edit3r.contract.settings import Settings

KINDS = (
    "reader",
    "editor",
    "segmenter",
    "detector",
    "selector",
    "reconstructor",
    "backbone",
    "head",
    "matcher",
    "rasterizer",
    "loss",
    "dataset",
    "trainer",
    "refiner",
    "critic",
    "writer",
    "command",
)
"""Every kind of component; each has one hook in `edit3r.contract.hookspecs`, named by `hook_name`.
"""


def hook_name(kind: str) -> str:
    """The hook through which a plugin offers components of `kind`."""
    return f"register_{kind}es" if kind.endswith("s") else f"register_{kind}s"


@dataclass(frozen=True)
class Component:
    """One component on offer: its name, where its class lives, what to know before building it."""

    name: str  # kebab-case, unique within its kind
    target: str  # "module:Class"; imported only when the component is built
    summary: str  # one line for `edit3r list-plugins`
    requires: tuple[str, ...] = ()  # importable module names that must be installed
    # pip extra that brings them: pip install "edit3r[extra]", or a package name of the plugin's
    # own; one that begins with a dash is all that follows `pip install`
    extra: str = ""
    parts: tuple[str, ...] = ()  # kinds built first and passed to the class by keyword
    licence: str = "Apache-2.0"  # of the code, and of weights it brings along
    # types of torch device it runs on, as ("cuda",); (): any
    devices: tuple[str, ...] = ()
    needs_network: bool = False
    supports_seed: bool = True  # False: the same seed may give another result
    # of an editor: what a run without --editor takes it for (`contract.instructions.Action`)
    actions: tuple[str, ...] = ()
    # of a writer: how the name of its file ends, as ".spz"; one without a dot, as "-colmap", is
    # that of a folder
    suffix: str = ""
    # of a writer: how that name begins in the folder of a run; "": as that of the scene
    stem: str = ""
    keeps: str = ""  # of a writer: what of a scene is in it, in a few words
    loses: str = ""  # of a writer: what of a scene is not in it
    min_views: int = 1
    max_views: int | None = None  # None: any number
    citation: str = ""
    # what it can load; `edit3r weights get NAME` fetches them
    weights: tuple[Weights, ...] = ()

    def __post_init__(self) -> None:
        check_name("component", self.name)
        who = f"component {self.name!r}"
        told = f"{who}: target {self.target!r} must read 'module:Class'"
        text = isinstance(self.target, str)
        check_declared(text and re.fullmatch("[^:]+:[^:]+", self.target), told)
        for field in ("summary", "extra", "licence", "citation", *_OF_WRITERS):
            value = getattr(self, field)
            told = f"{who}: {field} must be text, got {value!r}"
            check_declared(isinstance(value, str), told)
        for field in ("requires", "parts", "devices", "actions"):
            object.__setattr__(self, field, _texts(who, field, getattr(self, field)))
        given = self.weights
        told = f"{who}: weights must be a tuple of edit3r.contract.weights.Weights"
        held = isinstance(given, tuple) and all(
            isinstance(one, Weights) for one in given
        )
        check_declared(held, f"{told}, got {given!r}")
        plain = not any(sign in self.suffix + self.stem for sign in "/\\\0")
        check_declared(plain, f"{who}: suffix and stem are parts of a file's name")
        for part in self.parts:
            told = f"{who}: unknown part kind {part!r}; kinds are {', '.join(KINDS)}"
            check_declared(part in KINDS, told)
        limits = (self.min_views, 1 if self.max_views is None else self.max_views)
        told = f"{who}: min_views and max_views must be 1 or more"
        held = all(isinstance(limit, int) and limit >= 1 for limit in limits)
        check_declared(held, f"{told}, got {self.min_views}, {self.max_views}")

    @property
    def makes_folder(self) -> bool:
        """Whether a writer makes a folder instead of a file."""
        return "." not in self.suffix

    def file_name(self, scene: str = "scene") -> str:
        """The name of a writer's file or folder beside that of a scene (without its suffix)."""
        if not self.stem:
            return f"{scene}{self.suffix}"
        begin = self.stem if scene == "scene" else f"{scene}-{self.stem}"
        return f"{begin}{self.suffix}"


_OF_WRITERS = ("suffix", "stem", "keeps", "loses")


def _texts(who: str, field: str, value: object) -> tuple[str, ...]:
    """A tuple of texts from any sequence of them; a lone text would be read letter by letter."""
    if (
        isinstance(value, str)
        or not isinstance(value, Sequence)
        or not all(isinstance(item, str) for item in value)
    ):
        raise ValueError(
            f'{who}: {field} must be a tuple of names such as ("name",), got {value!r}'
        )
    return tuple(value)


@dataclass(frozen=True)
class Offer:
    """A component together with the plugin that offers it."""

    kind: str
    component: Component
    plugin: str  # entry point name
    version: str  # of the distribution; "" for a local file
    module: str = ""  # the one that declares it
    first_party: bool = False  # edit3r's own: keeps its name where another takes it

    @property
    def qualified_name(self) -> str:
        return f"{self.plugin}:{self.component.name}"


def component_name(component: Any) -> str:
    """The name it was asked for by, or its class's for an object that no plugin offers."""
    offer = getattr(component, "offer", None)
    return offer.component.name if offer is not None else type(component).__name__


class Configured:
    """A component: its settings, where it comes from, and the parts it was built with.

    The registry constructs it as `Class(settings, **parts)` and then sets the three attributes.
    """

    settings: "Settings"
    offer: Offer
    parts: Mapping[str, Any]  # by kind

    def __init__(self, settings: "Settings | None" = None) -> None:
        super().__init__()
        if settings is not None:  # a network calls this without any, and sets its own
            self.settings = settings
