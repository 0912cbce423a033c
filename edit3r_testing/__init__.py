"""Contract tests: one per kind of component, run over everything registered and by a stranger with
one import.

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
from edit3r_testing.network import BackboneContract, HeadContract, TinyBackbone
from edit3r_testing.rasterizer import RasterizerContract
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
from edit3r_testing.training import DatasetContract, LossContract, TrainerContract

CONTRACTS: dict[str, type[Contract]] = {
    contract.kind: contract
    for contract in (
        *(EditorContract, SegmenterContract, DetectorContract),
        *(MatcherContract, BackboneContract, HeadContract, ReconstructorContract),
        *(RasterizerContract, RefinerContract),
        *(DatasetContract, LossContract, TrainerContract),
        CommandContract,
    )
}
"""The contract of each kind."""

__all__ = [
    *(contract.__name__ for contract in CONTRACTS.values()),
    *("CONTRACTS", "Contract", "ContractViolation", "claims", "contract_for"),
    *("Photographed", "TinyBackbone", "cameras_around", "gaussian_cloud", "photograph"),
]


def contract_for(
    kind: str,
    component: str,
    plugin_files: tuple[str | Path, ...] = (),
    parts: Mapping[str, Any] | None = None,
    **settings: Any,
) -> type[Contract]:
    """The contract of `kind`, bound to a component by name, built with `settings`."""
    bound = {
        "component": component,
        "plugin_files": plugin_files,
        "parts": parts or {},
        "settings": settings,
    }
    return type(
        f"{kind.title()}{component.title().replace('-', '')}", (CONTRACTS[kind],), bound
    )
