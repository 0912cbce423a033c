"""One function of colour that explains the edits of two views, as paint or a filter is one.

The change r of a colour s is modelled as a partition of unity: `KNOTS` quadratic polynomials in s,
each one in force at its own lightness and blended linearly between, and a multiple of each
channel's root. The fit is iteratively reweighted least squares with Cauchy weights (Holland and
Welsch 1977). Channels that the edit drove to 0 or 1 are censored, as in tobit regression: they say
that the function reaches that bound, no more.
"""

from itertools import combinations_with_replacement

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r_model.edited_views import CHANGE, FITS

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
