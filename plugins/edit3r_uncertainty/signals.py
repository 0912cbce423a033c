"""The probability that a Gaussian's colour is wrong in a new view, from what the photos say of it.

Five signals of each Gaussian in a logistic function. Its constants were fitted to photos which no
run was given; `python benchmarks/verdict.py uncertainty DATA --fit` fits them again.
"""

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.rendering import render_each

# The numbers of this block: no figures kept.
WRONG = 0.05
"""A colour is wrong when it is off by more than this, in the mean of red, green and blue."""
WINDOW = 5  # in which the contrast of a photo is measured [pixels]
SEEN = 0.02  # contribution to a view [pixels] below which the view does not show a Gaussian
MOST_PHOTOS = 3  # more of them say no more
LEAST = 0.003  # contrast and misfit of a clean photo: below it they say no more

SIGNALS = {
    "contrast": 0.580,  # logarithm: a misplaced Gaussian matters more where colours change
    "misfit": 1.187,  # logarithm of the difference between the scene and the photos
    "opacity": -5.716,
    "others": -1.729,  # share of it that is shown by photos other than the one it came from
    "photos": -0.643,  # how many show it, up to `MOST_PHOTOS`
}
"""What multiplies each signal. Fitted: docs/notes/uncertainty.md."""
CONSTANT = 13.034  # fitted with them


def uncertainty(
    gaussians: Gaussians,
    cameras: Cameras,
    images: Float[Tensor, "view 3 height width"],
    rasterizer: Rasterizer,
) -> tuple[Float[Tensor, "1 gaussian"], Float[Tensor, "view gaussian"]]:
    """Uncertainty of one scene's Gaussians (batch 1); their contributions to each view [pixels].

    `images` (sRGB in [0, 1]) are what the scene was made from.
    """
    signals, shown = signals_of(gaussians, cameras, images, rasterizer)
    factors = torch.tensor(list(SIGNALS.values()))
    return probability(signals, shown, factors, CONSTANT), shown


def probability(
    signals: Float[Tensor, "gaussian signal"],
    shown: Float[Tensor, "view gaussian"],
    factors: Float[Tensor, "signal"],
    constant: float,
) -> Float[Tensor, "1 gaussian"]:
    """The logistic function of the signals; 1 for a Gaussian that no photo shows."""
    number = (signals @ factors + constant).sigmoid()
    return torch.where(photos_of(shown) == 0, torch.ones_like(number), number)[None]


def photos_of(shown: Float[Tensor, "view gaussian"]) -> Int[Tensor, "gaussian"]:
    """How many photos show each Gaussian."""
    return (shown > SEEN).sum(0)


def signals_of(
    gaussians: Gaussians,
    cameras: Cameras,
    images: Float[Tensor, "view 3 height width"],
    rasterizer: Rasterizer,
) -> tuple[Float[Tensor, "gaussian signal"], Float[Tensor, "view gaussian"]]:
    """The signals of `SIGNALS`, in its order, and each Gaussian's contributions to each view."""
    rendered = render_each(rasterizer, gaussians, cameras, "looking at the photos")
    misfit = (rendered.images[0].clamp(0, 1) - images).abs().mean(1)
    maps = torch.stack((_contrast(images), misfit, torch.ones_like(misfit)), 1)
    sums = torch.stack(
        [
            rasterizer.contributions(gaussians, cameras.select([view]), one[None])[0]
            for view, one in enumerate(maps)
        ]
    )
    shown = sums[..., 2]
    views = torch.arange(len(shown))[:, None]
    others = (shown * (gaussians.view_index != views)).sum(0)
    total = shown.sum(0).clamp(min=1e-6)
    signals = (
        (sums[..., 0].sum(0) / total + LEAST).log(),
        (sums[..., 1].sum(0) / total + LEAST).log(),
        gaussians.opacities[0],
        others / total,
        photos_of(shown).clamp(max=MOST_PHOTOS),
    )
    return torch.stack(signals, 1), shown


def _contrast(
    images: Float[Tensor, "view 3 height width"],
) -> Float[Tensor, "view height width"]:
    """Standard deviation of the colours around each pixel."""

    def mean(values: Tensor) -> Tensor:
        return F.avg_pool2d(values, WINDOW, 1, WINDOW // 2, count_include_pad=False)

    variance = mean(images.square()) - mean(images).square()
    return variance.clamp(min=0).sqrt().mean(1)
