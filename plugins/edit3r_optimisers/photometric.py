"""The loss of 3D Gaussian Splatting (equation 7): (1 - w) L1 + w D-SSIM."""

from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

__all__ = ["photometric_loss", "structural_similarity"]

WINDOW, SIGMA = 11, 1.5  # of the Gaussian window [pixels] (Wang et al. 2004)
C1, C2 = 0.01**2, 0.03**2  # for pictures in [0, 1]


def photometric_loss(
    image: Float[Tensor, "3 height width"], target: Float[Tensor, "3 height width"], ssim: float
) -> Float[Tensor, ""]:
    """In [0, 1] for pictures in [0, 1]; 0 where they are equal. D-SSIM is (1 - SSIM) / 2."""
    difference = (image - target).abs().mean()
    if ssim == 0:
        return difference
    return (1 - ssim) * difference + ssim * (1 - structural_similarity(image, target)) / 2


def structural_similarity(a: Float[Tensor, "c height width"], b: Float[Tensor, "c height width"]) -> Float[Tensor, ""]:
    """Mean SSIM over all windows that lie inside the picture; a picture smaller than a window gets a smaller one.

    Windows are matrix products: on a CPU a tenth of the time of a convolution's gradient, which bounds a whole fit.
    """
    rows, columns = (_windows(side, a.dtype, a.device) for side in a.shape[-2:])
    stacked = torch.stack((a, b, a * a, b * b, a * b))
    mean_a, mean_b, aa, bb, ab = (rows @ stacked @ columns.T).unbind(0)
    luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    structure = (2 * (ab - mean_a * mean_b) + C2) / (aa - mean_a**2 + bb - mean_b**2 + C2)
    return (luminance * structure).mean()


@cache
def _windows(side: int, dtype: torch.dtype, device: torch.device) -> Float[Tensor, "place side"]:
    """Row k averages pixels k to k + WINDOW with Gaussian weights."""
    length = min(WINDOW, side)
    offsets = torch.arange(length, dtype=torch.float64) - (length - 1) / 2
    weights = torch.exp(-0.5 * (offsets / SIGMA) ** 2)
    matrix = torch.zeros(side - length + 1, side, dtype=torch.float64)
    for place in range(len(matrix)):
        matrix[place, place : place + length] = weights / weights.sum()
    return matrix.to(device, dtype)
