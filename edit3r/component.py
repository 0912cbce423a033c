"""What a plugin says about each thing it offers, readable without importing the thing itself."""

from dataclasses import dataclass

KINDS = (
    "editor",
    "segmenter",
    "detector",
    "reconstructor",
    "backbone",
    "head",
    "matcher",
    "rasterizer",
    "loss",
    "dataset",
    "trainer",
)
"""Every kind of component; each has one hook in `edit3r.hookspecs`, named by `hook_name`."""


def hook_name(kind: str) -> str:
    """The hook through which a plugin offers components of `kind`."""
    return f"register_{kind}es" if kind.endswith("s") else f"register_{kind}s"


@dataclass(frozen=True)
class Component:
    """One component on offer: its name, where its class lives, and what a user should know before building it."""

    name: str  # kebab-case, unique within its kind
    target: str  # "module:Class"; imported only when the component is built
    summary: str  # one line for `edit3r list-plugins`
    requires: tuple[str, ...] = ()  # importable module names that must be installed
    extra: str = ""  # pip extra that brings them: pip install "edit3r[extra]", or a package name of the plugin's own
    parts: tuple[str, ...] = ()  # kinds built first and passed to the class by keyword
    licence: str = "Apache-2.0"  # of the code, and of weights it brings along
    needs_gpu: bool = False
    needs_network: bool = False
    supports_seed: bool = True  # False: the same seed may give another result
    min_views: int = 1
    max_views: int | None = None  # None: any number
    citation: str = ""

    def __post_init__(self) -> None:
        if not self.name or not self.name.replace("-", "").replace("_", "").isalnum() or self.name.lower() != self.name:
            raise ValueError(f"component name {self.name!r} must be lower-case letters, digits and dashes")
        if self.target.count(":") != 1 or not all(self.target.split(":")):
            raise ValueError(f"component {self.name!r}: target {self.target!r} must read 'module:Class'")
        unknown = [part for part in self.parts if part not in KINDS]
        if unknown:
            raise ValueError(f"component {self.name!r}: unknown part kind {unknown[0]!r}; kinds are {', '.join(KINDS)}")
