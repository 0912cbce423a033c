"""The edit as a function of colour: an affine map for every place, or one function for two views,
as paint or a filter is one.

Maps: ridge regression of the change r = edited - source on the source's colours s in a Gaussian
window: D = Cov(r, s) (Cov(s, s) + ridge I)^-1, d = mean r - D mean s. It is the guided filter of He
et al. 2013 with a colour guide. An unedited place gives exactly D = 0, d = 0.

One function: the change r of a colour s is modelled as a partition of unity: `KNOTS` quadratic
polynomials in s, each one in force at its own lightness and blended linearly between, and a
multiple of each channel's root. The fit is iteratively reweighted least squares with Cauchy weights
(Holland and Welsch 1977). Channels that the edit drove to 0 or 1 are censored, as in tobit
regression: they say that the function reaches that bound, no more.
"""

from itertools import combinations_with_replacement

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r_model.edited_views import CHANGE, FITS

# ---- a map for every place ----

CHANNELS = 12
"""Row-major 3x3 of D, then d."""

Pictures = Float[Tensor, "batch 3 height width"]


def fit_colour_maps(
    source: Pictures,
    edited: Pictures,
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


def _outer(a: Pictures, b: Pictures) -> Float[Tensor, "batch 9 height width"]:
    """Products of every channel of `a` with every channel of `b`, row-major."""
    return (a[:, :, None] * b[:, None]).flatten(1, 2)


def _matrices(flat: Float[Tensor, "batch 9 h w"]) -> Float[Tensor, "batch h w 3 3"]:
    return flat.permute(0, 2, 3, 1).unflatten(-1, (3, 3))


# ---- one function for two views ----

EXPLAINED = 3 / 255
"""What the function may leave of an edit [sRGB]: images of 8 bits round before and after."""

ROUNDED = 1.5 / 255
"""A channel this near to 0 or 1 was cut off there. No figure kept."""

MAX_PIXELS = 4_000
"""About as many changed pixels are fitted."""

KNOTS = 8

PRODUCTS = tuple(combinations_with_replacement(range(4), 2))
"""Of 1 and the three channels, the terms of a quadratic polynomial."""

LUMA = (0.299, 0.587, 0.114)  # formula of Rec. 601

Pixels = Float[Tensor, "pixel 3"]
Colours = Float[Tensor, "*pixel 3"]


def change_by_shared_function(source: Colours, change: Colours) -> Colours:
    """Fit the function to the pixels that changed; return the change it makes to all of them."""
    coefficients = _fitted(source.reshape(-1, 3), change.reshape(-1, 3))
    return (source + _features(source) @ coefficients).clamp(0, 1) - source


def _fitted(colours: Pixels, change: Pixels) -> Float[Tensor, "feature 3"]:
    """Coefficients of the change in the features of the colours."""
    changed = (change.abs().amax(-1) > CHANGE).nonzero()[:, 0]
    some = changed[:: max(1, len(changed) // MAX_PIXELS)]
    s, r = colours[some].double(), change[some].double()
    features, after = _features(s), s + r
    low, high = after <= ROUNDED, after >= 1 - ROUNDED
    # A channel that was cut off counts once the function falls short of it.
    counts = ~(low | high)
    goal, weights = r, counts.to(r.dtype)
    ridge = 1e-6 * torch.eye(features.shape[-1], dtype=r.dtype, device=r.device)
    for _ in range(FITS):
        weighted = features.mT * weights.mT[:, None]  # [channel, feature, pixel]
        moments, target = weighted @ features + ridge, weighted @ goal.mT[..., None]
        coefficients = torch.linalg.solve(moments, target)[..., 0].mT
        found = s + features @ coefficients
        beyond = (low & (found <= ROUNDED)) | (high & (found >= 1 - ROUNDED))
        left = torch.where(beyond, 0, after - found).abs().amax(-1, keepdim=True)
        counts, goal = counts | ~beyond, torch.where(beyond, found, after) - s
        weights = counts / (1 + (left / EXPLAINED).square())
    return coefficients.to(colours.dtype).contiguous()


def _features(colours: Colours) -> Float[Tensor, "*pixel 83"]:
    """The quadratic terms, shared out between the two next knots of lightness, and the roots."""
    padded = torch.cat((torch.ones_like(colours[..., :1]), colours), -1)
    products = torch.stack([padded[..., i] * padded[..., j] for i, j in PRODUCTS], -1)
    place = (KNOTS - 1) * (colours @ colours.new_tensor(LUMA))[..., None]
    knots = torch.arange(KNOTS, dtype=colours.dtype, device=colours.device)
    near = (1 - (place - knots).abs()).clamp(min=0)
    local = (near[..., None] * products[..., None, :]).flatten(-2)
    return torch.cat((local, colours.clamp(min=0).sqrt()), -1)
