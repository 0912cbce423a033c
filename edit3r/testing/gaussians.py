"""What every set of Gaussians must hold, asked of reconstructors and of heads."""

import torch

from edit3r.testing.contract import Contract
from edit3r.types import Gaussians


def require_valid_gaussians(contract: Contract, gaussians: Gaussians, batch: int, view_count: int) -> None:
    """Finite, unit quaternions, positive scales, opacities in [0, 1], view numbers of existing views."""
    contract.require(
        isinstance(gaussians, Gaussians), f"gaussians is a {type(gaussians).__name__}; return edit3r.Gaussians."
    )
    contract.require(gaussians.count > 0, "there is not one Gaussian; return at least one per scene.")
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        tensor = getattr(gaussians, name)
        contract.require_tensor(f"Gaussians.{name}", tensor, (batch, *tensor.shape[1:]))
    norms = gaussians.quats.norm(dim=-1)
    contract.require_range(
        "norms of Gaussians.quats", norms, 0.999, 1.001, "normalise them, F.normalize(quats, dim=-1)"
    )
    contract.require_range("Gaussians.opacities", gaussians.opacities, 0, 1, "squash them, for example with .sigmoid()")
    least = gaussians.scales.min().item()
    contract.require(least > 0, f"the least of Gaussians.scales is {least:.4g}; use exp or softplus, they must be > 0.")
    index = gaussians.view_index
    contract.require(
        bool(((index >= -1) & (index < view_count)).all()),
        f"Gaussians.view_index spans [{index.min()}, {index.max()}] for {view_count} views; "
        "it is the input view a Gaussian came from, or -1.",
    )


def require_same_gaussians(contract: Contract, what: str, first: Gaussians, second: Gaussians, fix: str, atol: float):
    """Every field agrees, relative to its largest value."""
    contract.require(
        first.count == second.count, f"{what}: {first.count} against {second.count} Gaussians per scene; {fix}."
    )
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        a, b = getattr(first, name), getattr(second, name)
        size = max(1e-8, torch.nan_to_num(b).abs().max().item())
        contract.require_equal(f"{what}, Gaussians.{name}", a / size, b / size, fix, atol)
