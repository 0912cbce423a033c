"""What a weight file turns into, whatever its format."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor


@dataclass(frozen=True)
class PartConfig:
    """Which component a part was, and the settings that give it its shape."""

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class NetworkConfig:
    """Everything needed to build the network that a weight file fills."""

    backbone: PartConfig
    head: PartConfig
    resolution: int = 256  # side of the square with the area the network was trained at [pixels]


@dataclass(frozen=True)
class LoadedWeights:
    """One weight file, its tensors by our names (`backbone.*`, `head.*`), read only when asked for."""

    config: NetworkConfig
    state: Mapping[str, Tensor]  # on the CPU, in the file's dtype
    source: str  # path, or hub id with revision
    kind: str  # "noposplat", "mast3r" or "edit3r"
    sha256: str  # of the file that holds the tensors
    licence: str  # what is known about using these weights
    drawn: tuple[str, ...] = ()  # prefixes that the file is known not to hold: they are drawn at random
    unexpected: tuple[str, ...] = ()  # keys in the file that the network has no place for

    def facts(self) -> dict[str, str]:
        """For a run's manifest."""
        return {"source": self.source, "kind": self.kind, "sha256": self.sha256, "licence": self.licence}
