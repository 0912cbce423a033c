"""Alignment of two reconstructions of one scene: the ratio of their lengths."""

from jaxtyping import Float
from torch import Tensor

__all__ = ["median_scale"]


def median_scale(source: Float[Tensor, "point 3"], target: Float[Tensor, "point 3"]) -> Float[Tensor, ""]:
    """The factor by which `source` becomes as large as `target`: the median ratio of distances from the origin.

    Both hold the same points (or camera centres) in frames with one origin; 1 for no points.
    """
    if len(source) == 0:
        return target.new_ones(())
    return (target.norm(dim=-1) / source.norm(dim=-1).clamp(min=1e-12)).median()
