"""Step sizes over a fit: centres slow down, everything else keeps its pace (3D Gaussian Splatting, released code)."""

import torch

from edit3r_optimisers.settings import FitSettings

__all__ = ["active_degree", "step_sizes", "view_at"]

DETAIL_SHARE = 1 / 20
"""Harmonics above the constant move slower by this."""


def step_sizes(settings: FitSettings, step: int, steps: int, extent: float) -> dict[str, float]:
    """Adam's step of each parameter group at `step` in [0, steps); the centres' falls log-linearly."""
    start, end = settings.means_rate, settings.means_rate_end
    share = step / max(1, steps - 1)
    means = start ** (1 - share) * end**share if start > 0 and end > 0 else start
    return {
        "means": means * extent,
        "scales": settings.scale_rate,
        "quats": settings.rotation_rate,
        "opacities": settings.opacity_rate,
        "colour": settings.colour_rate,
        "detail": settings.colour_rate * DETAIL_SHARE,
    }


def active_degree(settings: FitSettings, step: int, steps: int) -> int:
    """Degree of the harmonics in use: from 0 up to the setting, each for an even share of the fit."""
    return min(settings.degree, step * (settings.degree + 1) // steps)


def view_at(step: int, views: int, seed: int) -> int:
    """Which view a step looks at: every view once a round, each round in its own random order."""
    generator = torch.Generator().manual_seed((seed * 1_000_003 + step // views) % 2**63)
    return int(torch.randperm(views, generator=generator)[step % views])
