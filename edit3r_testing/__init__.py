"""Contract tests: one per kind of component, over everything registered or by one import.

In a test file:

    from edit3r_testing import EditorContract

    class TestSepia(EditorContract):
        component = "sepia"

Every violation says what the author has to change.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from edit3r_testing.command import CommandContract
from edit3r_testing.contract import Contract, ContractViolation, claims
from edit3r_testing.editing import DetectorContract, EditorContract, SegmenterContract
from edit3r_testing.judging import CriticContract
from edit3r_testing.network import BackboneContract, HeadContract, TinyBackbone
from edit3r_testing.rasterizer import RasterizerContract
from edit3r_testing.reading import ReaderContract
from edit3r_testing.reconstruction import (
    MatcherContract,
    ReconstructorContract,
    RefinerContract,
)
from edit3r_testing.scenes import (
    Photographed,
    cameras_around,
    gaussian_cloud,
    photograph,
)
from edit3r_testing.second_device import second_device
from edit3r_testing.selecting import SelectorContract
from edit3r_testing.training import DatasetContract, LossContract, TrainerContract
from edit3r_testing.writing import WriterContract

CONTRACTS: dict[str, type[Contract]] = {
    contract.kind: contract for contract in Contract.__subclasses__()
}
"""The contract of each kind."""

__all__ = [
    *(contract.__name__ for contract in CONTRACTS.values()),
    "CONTRACTS",
    "Contract",
    "ContractViolation",
    "Photographed",
    "TinyBackbone",
    "cameras_around",
    "claims",
    "contract_for",
    "gaussian_cloud",
    "photograph",
    "second_device",
]


def contract_for(
    kind: str,
    component: str,
    plugin_files: tuple[str | Path, ...] = (),
    parts: Mapping[str, Any] | None = None,
    **settings: Any,
) -> type[Contract]:
    """The contract of `kind`, bound to a component by name, built with `settings`."""
    name = f"{kind.title()}{component.title().replace('-', '')}"
    bound = {
        "component": component,
        "plugin_files": plugin_files,
        "parts": parts or {},
        "settings": settings,
    }
    return type(name, (CONTRACTS[kind],), bound)
