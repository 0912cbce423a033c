"""The edit as a local function of colour: per place the affine map that turns the photo into its edited version.

Ridge regression of the change r = edited - photo on the photo's colours s in a Gaussian window:
D = Cov(r, s) (Cov(s, s) + ridge I)^-1, d = mean r - D mean s; an unedited place gives exactly D = 0, d = 0.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

CHANNELS = 12
"""Row-major 3x3 of D, then d."""


def fit_colour_maps(
    photos: Float[Tensor, "batch 3 height width"],
    edited: Float[Tensor, "batch 3 height width"],
    stride: int = 1,
    sigma: float = 1.0,
    ridge: float = 2e-3,
) -> Float[Tensor, "batch 12 height2 width2"]:
    """Maps of every `stride` x `stride` cell, fitted in the cell and `sigma` cells around it."""
    change = edited - photos
    moments = torch.cat((photos, change, _outer(change, photos), _outer(photos, photos)), 1)
    moments = blur(F.avg_pool2d(moments, stride) if stride > 1 else moments, sigma)
    mean_s, mean_r, cross, own = moments.split((3, 3, 9, 9), 1)
    cross, own = cross - _outer(mean_r, mean_s), own - _outer(mean_s, mean_s)
    matrix = _matrices(own) + ridge * torch.eye(3, dtype=photos.dtype, device=photos.device)
    slope = _matrices(cross) @ torch.linalg.inv(matrix)  # D = Cov(r, s) (Cov(s, s) + ridge)^-1
    offset = mean_r - torch.einsum("bhwij,bjhw->bihw", slope, mean_s)
    return torch.cat((slope.flatten(-2).permute(0, 3, 1, 2), offset), 1)


def change_of(
    maps: Float[Tensor, "batch 12 height width"], photos: Float[Tensor, "batch 3 height width"]
) -> Float[Tensor, "batch 3 height width"]:
    """The colour change that maps give to photos: D s + d."""
    slope = maps[:, :9].unflatten(1, (3, 3))
    return (slope * photos[:, None]).sum(2) + maps[:, 9:]


def blur(x: Float[Tensor, "batch channel height width"], sigma: float) -> Float[Tensor, "batch channel height width"]:
    """Gaussian mean with the border repeated."""
    radius = int(2.5 * sigma + 0.5)
    offsets = torch.arange(-radius, radius + 1, dtype=x.dtype, device=x.device)
    kernel = torch.exp(-0.5 * (offsets / sigma) ** 2)
    kernel = (kernel / kernel.sum()).expand(x.shape[1], 1, -1)
    padded = F.pad(x, (radius,) * 4, mode="replicate")
    rows = F.conv2d(padded, kernel[..., None, :], groups=x.shape[1])
    return F.conv2d(rows, kernel[..., None], groups=x.shape[1])


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return (a[:, :, None] * b[:, None]).flatten(1, 2)


def _matrices(flat: Tensor) -> Tensor:
    return flat.permute(0, 2, 3, 1).unflatten(-1, (3, 3))
