"""Fit Gaussians to images from known cameras: the loop of 3D Gaussian Splatting (Kerbl et al.
2023).

One view a step, L1 and D-SSIM, Adam; there are as many Gaussians in the end as in the beginning.
The same inputs give the same result: everything random is drawn from the seed and the step.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.reporting import progress
from edit3r.contract.settings import Settings
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.geometry.rotations import normalise_quats

WINDOW, SIGMA = 11, 1.5  # of the Gaussian window of SSIM [pixels] (Wang et al. 2004)
C1, C2 = 0.01**2, 0.03**2  # for images in [0, 1]; as published (Wang et al. 2004)
OPACITY_RANGE = (1e-4, 1 - 1e-4)  # outside, the logit has no useful gradient
# of Adam; gradients of single Gaussians are tiny (3DGS, released code)
BETAS, EPSILON = (0.9, 0.999), 1e-15
MEANS_RATES = 1.6e-4, 1.6e-6  # first and last step of the centres [extents]
# of logarithms and logits; as in the released code of 3DGS
RATES = {"scales": 5e-3, "quats": 1e-3, "opacities": 0.05}


class FitSettings(Settings):
    """One fit. Step sizes are those of 3D Gaussian Splatting (Kerbl et al. 2023, section 7 and the
    authors' released code) unless the description says otherwise; `extent` is a typical distance to
    the scene.
    """

    ssim: float = Field(0.2, ge=0, le=1)
    """weight of D-SSIM; the rest is the absolute difference"""
    colour_rate: float = Field(0.02, ge=0, le=1)
    """step of the colours; published 0.0025, for 30000 steps"""
    seed: int = Field(0, ge=0, lt=2**31)
    """of the edits, in a run the run's own; and of the order of views"""


class TargetImages:
    """The images that are fitted to; a subclass may change them while the fit goes on."""

    def __init__(self, images: Float[Tensor, "view 3 height width"]) -> None:
        self.images = images

    def before_step(self, step: int, scene: Callable[[], Gaussians]) -> None:
        """Called before every step with a function that returns the Gaussians so far."""


@dataclass(frozen=True)
class Fitted:
    """A fitted scene, and the loss of each step before it was taken, each of one view."""

    gaussians: Gaussians
    losses: tuple[float, ...]


def fit(
    start: Gaussians,
    cameras: Cameras,
    targets: TargetImages,
    rasterizer: Rasterizer,
    settings: FitSettings,
    steps: int,
    text: str,
) -> Fitted:
    """Move the Gaussians of one scene (batch 1) until they look like `targets` from `cameras`.

    The settings' seed decides the order of the views, `text` is what the progress bar says.
    """
    scene, extent, losses = TrainableGaussians(start), scene_extent(start, cameras), []
    for step in range(steps):
        targets.before_step(step, partial(scene.gaussians, detached=True))
        view = view_at(step, cameras.count, settings.seed)
        with torch.enable_grad():
            shown = rasterizer.render(scene.gaussians(), cameras.select([view]))
            image, target = shown.images[0, 0], targets.images[view]
            loss = photometric_loss(image, target, settings.ssim)
        losses.append(float(loss.detach()))
        scene.step(loss, step_sizes(settings, step, steps, extent))
        progress(text, step + 1, steps)
    return Fitted(scene.gaussians(detached=True), tuple(losses))


class TrainableGaussians:
    """The parameters of one scene, and Adam over them with one step size per kind of parameter.

    Scales are logarithms, opacities logits, quaternions of any norm; of the harmonics only the
    constant one is kept.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self.view_index = gaussians.view_index
        tiny = torch.finfo(gaussians.scales.dtype).tiny
        values = {
            "means": gaussians.means[0],
            "scales": gaussians.scales[0].clamp(min=tiny).log(),
            "quats": gaussians.quats[0],
            "opacities": gaussians.opacities[0].clamp(*OPACITY_RANGE).logit(),
            "colour": gaussians.harmonics[0, :, :1],
        }
        self.parameters = {
            name: value.detach().clone().requires_grad_(True)
            for name, value in values.items()
        }
        groups = [
            {"params": [value], "name": name} for name, value in self.parameters.items()
        ]
        self.adam = torch.optim.Adam(groups, betas=BETAS, eps=EPSILON)

    def gaussians(self, detached: bool = False) -> Gaussians:
        """Return a batch of one; differentiable in the parameters unless `detached`."""
        values = self.parameters
        if detached:
            values = {name: value.detach() for name, value in values.items()}
        return Gaussians(
            values["means"][None],
            values["scales"].exp()[None],
            normalise_quats(values["quats"])[None],
            values["opacities"].sigmoid()[None],
            values["colour"][None],
            self.view_index,
        )

    def step(self, loss: Float[Tensor, ""], sizes: Mapping[str, float]) -> None:
        """One step of Adam against `loss`; `sizes` are the step sizes by parameter."""
        self.adam.zero_grad()
        loss.backward()
        for group in self.adam.param_groups:
            group["lr"] = sizes[group["name"]]
        self.adam.step()


def scene_extent(gaussians: Gaussians, cameras: Cameras) -> float:
    """Return the median distance from cameras to Gaussians of one scene [scene units].

    The paper takes the cameras' distance from their middle, which is the same for cameras around a
    scene but next to nothing for two photos taken a step apart.
    """
    centres = cameras.c2w[0, :, :3, 3]
    return max(float(torch.cdist(centres, gaussians.means[0].detach()).median()), 1e-6)


def step_sizes(
    settings: FitSettings, step: int, steps: int, extent: float
) -> dict[str, float]:
    """Return Adam's step size of each parameter at `step` in [0, steps).

    The centres' falls log-linearly, the others stay (3D Gaussian Splatting, released code).
    """
    start, end = MEANS_RATES
    share = step / max(1, steps - 1)
    means = start ** (1 - share) * end**share
    return {**RATES, "means": means * extent, "colour": settings.colour_rate}


def view_at(step: int, views: int, seed: int) -> int:
    """The view that a step renders: each once a round, every round in its own random order."""
    number = (seed * 1_000_003 + step // views) % 2**63
    generator = torch.Generator().manual_seed(number)
    return int(torch.randperm(views, generator=generator)[step % views])


def photometric_loss(
    image: Float[Tensor, "3 height width"],
    target: Float[Tensor, "3 height width"],
    ssim: float,
) -> Float[Tensor, ""]:
    """Return (1 - ssim) L1 + ssim D-SSIM, where D-SSIM is (1 - SSIM) / 2 (3D Gaussian Splatting,
    equation 7).

    It is in [0, 1] for images in [0, 1], and 0 where they are equal.
    """
    difference = (image - target).abs().mean()
    if ssim == 0:
        return difference
    dissimilarity = (1 - differentiable_ssim(image, target)) / 2
    return (1 - ssim) * difference + ssim * dissimilarity


def differentiable_ssim(
    a: Float[Tensor, "c height width"], b: Float[Tensor, "c height width"]
) -> Float[Tensor, ""]:
    """Return the mean SSIM over all windows inside the image; an image smaller than a window gets a
    smaller one.

    Windows are matrix products: on a CPU a tenth of the time of a convolution's gradient, which
    bounds a whole fit.
    """
    rows, columns = (_windows(side, a.dtype, a.device) for side in a.shape[-2:])
    stacked = torch.stack((a, b, a * a, b * b, a * b))
    mean_a, mean_b, aa, bb, ab = (rows @ stacked @ columns.T).unbind(0)
    luminance = (2 * mean_a * mean_b + C1) / (mean_a**2 + mean_b**2 + C1)
    variances = aa - mean_a**2 + bb - mean_b**2
    structure = (2 * (ab - mean_a * mean_b) + C2) / (variances + C2)
    return (luminance * structure).mean()


@cache
def _windows(
    side: int, dtype: torch.dtype, device: torch.device
) -> Float[Tensor, "position side"]:
    """Return a matrix whose row k averages pixels k to k + WINDOW with Gaussian weights."""
    length = min(WINDOW, side)
    offsets = torch.arange(length, dtype=torch.float64) - (length - 1) / 2
    weights = torch.exp(-0.5 * (offsets / SIGMA) ** 2)
    matrix = torch.zeros(side - length + 1, side, dtype=torch.float64)
    for position in range(len(matrix)):
        matrix[position, position : position + length] = weights / weights.sum()
    return matrix.to(device, dtype)
