"""What lies around each pixel of a map."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

__all__ = ["largest_around"]


def largest_around(maps: Float[Tensor, "*batch height width"], reach: int) -> Float[Tensor, "*batch height width"]:
    """The largest value within a square of `reach` pixels around, inside the picture; differentiable."""
    found = maps.reshape(-1, 1, *maps.shape[-2:])
    for kernel, padding in (((2 * reach + 1, 1), (reach, 0)), ((1, 2 * reach + 1), (0, reach))):  # the square, by turns
        found = F.max_pool2d(found, kernel, stride=1, padding=padding)
    return found.reshape(maps.shape)
