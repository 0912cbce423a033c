"""The edit as a local function of colour: an affine map for every place.

Ridge regression of the change r = edited - source on the source's colours s in a Gaussian window:
D = Cov(r, s) (Cov(s, s) + ridge I)^-1, d = mean r - D mean s. It is the guided filter of He et al.
2013 with a colour guide. An unedited place gives exactly D = 0, d = 0.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

CHANNELS = 12
"""Row-major 3x3 of D, then d."""

Colours = Float[Tensor, "batch 3 height width"]


def fit_colour_maps(
    source: Colours,
    edited: Colours,
    stride: int = 1,
    sigma: float = 1.0,
    ridge: float = 2e-3,
) -> Float[Tensor, "batch 12 height2 width2"]:
    """Fit the map of every `stride` x `stride` cell to the cell and `sigma` cells around it."""
    change = edited - source
    products = _outer(change, source), _outer(source, source)
    moments = torch.cat((source, change, *products), 1)
    moments = F.avg_pool2d(moments, stride) if stride > 1 else moments
    mean_s, mean_r, cross, own = blur(moments, sigma).split((3, 3, 9, 9), 1)
    cov_rs = _matrices(cross - _outer(mean_r, mean_s))
    cov_ss = _matrices(own - _outer(mean_s, mean_s))
    identity = torch.eye(3, dtype=source.dtype, device=source.device)
    slope = cov_rs @ torch.linalg.inv(cov_ss + ridge * identity)
    offset = mean_r - torch.einsum("bhwij,bjhw->bihw", slope, mean_s)
    return torch.cat((slope.flatten(-2).permute(0, 3, 1, 2), offset), 1)


def change_of(maps: Float[Tensor, "*batch 12 height width"], source: Tensor) -> Tensor:
    """Compute the colour change D s + d that the maps give to the source images."""
    slope, offset = maps.split((9, 3), -3)
    return (slope.unflatten(-3, (3, 3)) * source.unsqueeze(-4)).sum(-3) + offset


def blur(x: Float[Tensor, "batch channel height width"], sigma: float) -> Tensor:
    """Blur with a Gaussian of standard deviation `sigma` [pixels]; the border is repeated."""
    radius = int(2.5 * sigma + 0.5)
    offsets = torch.arange(-radius, radius + 1, dtype=x.dtype, device=x.device)
    kernel = torch.exp(-0.5 * (offsets / sigma) ** 2)
    kernel = (kernel / kernel.sum()).expand(x.shape[1], 1, -1)
    padded = F.pad(x, (radius,) * 4, mode="replicate")
    rows = F.conv2d(padded, kernel[..., None, :], groups=x.shape[1])
    return F.conv2d(rows, kernel[..., None], groups=x.shape[1])


def blur_maps(maps: Float[Tensor, "batch view height width"], sigma: float) -> Tensor:
    """Blur one map of each view."""
    return blur(maps.flatten(0, 1)[:, None], sigma).view_as(maps)


def _outer(a: Colours, b: Colours) -> Float[Tensor, "batch 9 height width"]:
    """Products of every channel of `a` with every channel of `b`, row-major."""
    return (a[:, :, None] * b[:, None]).flatten(1, 2)


def _matrices(flat: Float[Tensor, "batch 9 h w"]) -> Float[Tensor, "batch h w 3 3"]:
    return flat.permute(0, 2, 3, 1).unflatten(-1, (3, 3))
