"""Refine Gaussians by photometric steps on the input views; the cameras stay.

Each step renders one input view, in turn, and moves colours, opacities, sizes and centres a little
towards its image. A share of the pixels is held back from the loss; the latest state that is about
the best by them is returned: it is never worse on them than the start.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float
from pydantic import Field
from torch import Tensor
from torch.nn.functional import (
    adaptive_avg_pool2d,
    adaptive_max_pool2d,
    smooth_l1_loss,
)

from edit3r.contract.interfaces import Rasterizer, RefineInputs, Refiner
from edit3r.contract.reporting import note, progress
from edit3r.contract.settings import Settings
from edit3r.contract.types import Cameras, Gaussians
from edit3r.kit.compute.layers import one_thread
from edit3r.kit.geometry.harmonics import colour_to_dc
from edit3r.kit.geometry.maps import size_of
from edit3r.kit.photos.images import evenly

# The numbers of this block: docs/notes/simplify.md.
LEAST_ERROR = 1e-12  # below it, decibels mean nothing
OPACITY_RANGE = (1e-4, 1 - 1e-4)  # outside, the logit has no useful gradient
BETAS, EPSILON = (0.7, 0.99), 1e-8  # of Adam: few steps must do
# share of the steps after which they get shorter, and how short the last one is
CALM, LAST_SHARE = 0.6, 0.2
MOST_VIEWS = 20  # whose steps a refinement takes: of more views, each takes fewer
TELLING_VIEWS = 8  # that tell the error before and after, where there are more
# error of a pixel [sRGB] below which its square counts, and beyond which its size
SQUARED_BELOW = 0.05
# times the least error of the held-back pixels up to which a later state counts as good: few pixels
# tell no less, and what is stopped early is soft
AS_GOOD = 1.02
HALF_EVERY = 4  # rounds of large images, of which the first is at half the size


class RefineSettings(Settings):
    """Step sizes of Adam, in units that do not depend on the scene, and what is held back."""

    colour: float = Field(0.05, ge=0, le=1)
    """step of the harmonics"""
    opacity: float = Field(0.55, ge=0, le=1)
    """step of the opacities' logits"""
    scale: float = Field(0.2, ge=0, le=1)
    """step of the scales' logarithms"""
    growth: float = Field(1.15, ge=1, le=1000)
    """most times as large as it was that a Gaussian may become: what grows over a depth edge at the
    photos stands before others' surfaces between them
    """
    recolouring: float = Field(0.15, gt=0, le=1000)
    """most by which a Gaussian's colour may change [sRGB]: one that the photos hardly show would
    become black or white, since Adam's steps are as long for it as for others
    """
    centre: float = Field(0.2, ge=0, le=1)
    """step of the centres [own smallest two scales' mean]"""
    half_above: int = Field(768, ge=1)
    """longer side above which a quarter of the steps are at half the size, for less time and so
    that the scene holds where it is drawn smaller [pixels]
    """
    held_back: float = Field(0.03, gt=0, lt=1)
    """share of pixels out of the loss, to know the best state"""
    seed: int = Field(0, ge=0)
    """chooses the held-back pixels"""


@dataclass(frozen=True)
class Refined:
    """Better Gaussians, and how the steps went. Mean squared errors are over the pixels of the
    input views, of many those of some, sRGB.
    """

    gaussians: Gaussians
    steps: int  # taken until the state that is returned
    # squared error of the held-back pixels before and after
    held_back: tuple[float, float]
    fitted: tuple[float, float]  # the same of the others

    @property
    def facts(self) -> dict[str, float]:
        """The number of steps, and what they gained [dB]."""
        gains = (
            10 * math.log10(max(before, LEAST_ERROR) / max(after, LEAST_ERROR))
            for before, after in (self.held_back, self.fitted)
        )
        held_back, fitted = (round(gain, 3) for gain in gains)
        return {
            "steps": self.steps,
            "db_gained_on_held_back_pixels": held_back,
            "db_gained_on_others": fitted,
        }


@one_thread()
def refine(
    gaussians: Gaussians,
    cameras: Cameras,
    images: Float[Tensor, "batch camera 3 height width"],
    rasterizer: Rasterizer,
    steps: int,
    settings: RefineSettings | None = None,
) -> Refined:
    """Take up to `steps` steps, each towards one of `images` as seen from `cameras`.

    The same inputs give the same result on one device. Works under `torch.no_grad()` too.
    """
    settings = settings or RefineSettings()
    kept_out = _held_back(images, settings)
    counts = ~kept_out
    groups = kept_out, counts
    before = _errors(gaussians, cameras, images, rasterizer, groups)
    variables = _Variables(gaussians, settings)
    best, taken, errors, rounds = gaussians, 0, [], []
    large = max(images.shape[-2:]) > settings.half_above
    small = _halved(images, counts) if large else (images, counts)
    last_round = (steps - 1) // cameras.count
    for step in range(steps if before[0] > 0 else 0):
        view, done = [step % cameras.count], step // cameras.count
        coarse = large and done % HALF_EVERY == 0 and done < last_round
        image, counted = small if coarse else (images, counts)
        image, counted = image[:, view], counted[:, view]
        camera = cameras.select(view).at(size_of(image))
        with torch.enable_grad():
            shown = rasterizer.render(variables.gaussians(), camera).images
            loss = (
                smooth_l1_loss(shown, image, reduction="none", beta=SQUARED_BELOW).mean(
                    2
                )
                * counted
            ).mean()
        if not coarse:
            error = (shown.detach() - image).square().mean(2)
            errors.append(float(error[kept_out[:, view]].mean()))
        # Each view pulls the others' surfaces to itself: shorter steps in the end settle between
        # them.
        past = (step / steps - CALM) / (1 - CALM)
        variables.step(loss, 1 - (1 - LAST_SHARE) * max(0.0, past))
        progress("refine", step + 1, steps)
        # Views differ, so states are compared by their last error of every view.
        if not coarse and (len(errors) % cameras.count == 0 or step == steps - 1):
            newest = errors[-cameras.count :]
            rounds.append(sum(newest) / len(newest))
            if rounds[-1] <= AS_GOOD * min(rounds):
                best, taken = _detached(variables.gaussians()), step + 1
    after = _errors(best, cameras, images, rasterizer, groups) if taken else before
    if after[0] >= before[0]:
        best, taken, after = gaussians, 0, before
    return Refined(best, taken, *zip(before, after))


@torch.no_grad()
def _errors(
    gaussians: Gaussians,
    cameras: Cameras,
    images: Float[Tensor, "batch camera 3 height width"],
    rasterizer: Rasterizer,
    groups: tuple[Bool[Tensor, "batch camera height width"], ...],
) -> tuple[float, ...]:
    """Mean squared error of each group of pixels, of many views by some."""
    views = evenly(range(cameras.count), TELLING_VIEWS)
    shown = rasterizer.render(gaussians, cameras.select(views)).images
    error = (shown - images[:, views]).square().mean(2)
    return tuple(float(error[group[:, views]].mean()) for group in groups)


def _halved(
    images: Float[Tensor, "batch camera 3 height width"],
    counts: Bool[Tensor, "batch camera height width"],
) -> tuple[Tensor, Tensor]:
    """The images at half the size, and the pixels there of which all four count."""
    height, width = size_of(images)
    half = max(1, round(height / 2)), max(1, round(width / 2))
    small = adaptive_avg_pool2d(images.flatten(0, 1), half)
    whole = -adaptive_max_pool2d(-counts.flatten(0, 1).to(images), half)
    batch = images.shape[:2]
    return small.unflatten(0, batch), whole.unflatten(0, batch) > 0


class RefineRefiner(Refiner):
    """Sharpens the Gaussians by photometric steps on the views that show the edit."""

    class Settings(RefineSettings):
        steps: int = Field(
            12,
            ge=0,
            le=10000,
            description="most steps for each view, each towards one; "
            f"more than {MOST_VIEWS} views take as many as {MOST_VIEWS}",
        )

    settings: Settings

    def __call__(self, gaussians: Gaussians, inputs: RefineInputs) -> Gaussians:
        """Follow the views alone: photos that were not edited would pull the edit back out."""
        views = inputs.views
        shown = inputs.cameras.select(range(views.count)).at(views.image_size)
        steps = self.settings.steps * min(views.count, MOST_VIEWS)
        refined = refine(
            gaussians,
            shown,
            views.images,
            inputs.rasterizer,
            steps,
            self.settings,
        )
        note("refine", refined.facts)
        return refined.gaussians


class Adam:
    """Moves `values` in place by Adam (Kingma and Ba 2015); `rates` are their step sizes.

    `torch.optim` computes the same bits where no gradient is 0, but its first optimizer of a
    process imports torch's compiler: two seconds, more than all steps of a usual refinement
    together.
    """

    def __init__(self, values: Sequence[Tensor], rates: Sequence[float]) -> None:
        self.values, self.rates, self.steps = list(values), list(rates), 0
        self.first, self.second = (
            [torch.zeros_like(value) for value in self.values] for _ in range(2)
        )

    @torch.no_grad()
    def step(self, gradients: Sequence[Tensor], length: float = 1.0) -> None:
        """One step against the gradients, as the values go; `length` is a share of the sizes."""
        self.steps += 1
        unbiased = [1 - beta**self.steps for beta in BETAS]
        for value, rate, gradient, first, second in zip(
            self.values, self.rates, gradients, self.first, self.second
        ):
            first.lerp_(gradient, 1 - BETAS[0])
            second.mul_(BETAS[1]).addcmul_(gradient, gradient, value=1 - BETAS[1])
            spread = second.sqrt().div_(math.sqrt(unbiased[1])).add_(EPSILON)
            # What this view does not show stays: else momentum alone would carry it on through all
            # other views' steps.
            value.addcdiv_(
                first * (gradient != 0), spread, value=-length * rate / unbiased[0]
            )


class _Variables:
    """The unconstrained numbers that Adam moves, from which valid Gaussians are made."""

    def __init__(self, gaussians: Gaussians, settings: RefineSettings) -> None:
        self.start = _detached(gaussians)
        self.unit = self.start.scales.sort(-1).values[..., 1:].mean(-1, keepdim=True)
        values = {
            "colour": self.start.harmonics,
            "opacity": self.start.opacities.clamp(*OPACITY_RANGE).logit(),
            "scale": self.start.scales.clamp(
                min=torch.finfo(self.start.scales.dtype).tiny
            ).log(),
            "centre": torch.zeros_like(self.start.means),
        }
        self.values = {
            name: value.clone().requires_grad_(True) for name, value in values.items()
        }
        self.largest = values["scale"] + math.log(settings.growth)
        grey = torch.tensor([0.5, 0.5, 0.5])
        self.range = float(colour_to_dc(grey + settings.recolouring)[0])
        self.optimizer = Adam(
            list(self.values.values()),
            [getattr(settings, name) for name in self.values],
        )

    def gaussians(self) -> Gaussians:
        return replace(
            self.start,
            means=self.start.means + self.values["centre"] * self.unit,
            scales=self.values["scale"].exp(),
            opacities=self.values["opacity"].sigmoid(),
            harmonics=self.values["colour"],
        )

    def step(self, loss: Float[Tensor, ""], length: float) -> None:
        self.optimizer.step(
            torch.autograd.grad(loss, list(self.values.values())), length
        )
        with torch.no_grad():
            self.values["scale"].clamp_(max=self.largest)
            colour, start = self.values["colour"], self.start.harmonics
            colour.clamp_(start - self.range, start + self.range)


def _held_back(
    images: Float[Tensor, "batch camera 3 height width"], settings: RefineSettings
) -> Bool[Tensor, "batch camera height width"]:
    """Choose the pixels kept out of the loss: at least one, and not all."""
    batch, cameras, _, height, width = images.shape
    generator = torch.Generator().manual_seed(settings.seed)
    order = torch.randperm(batch * cameras * height * width, generator=generator)
    count = min(max(1, round(settings.held_back * order.numel())), order.numel() - 1)
    chosen = torch.zeros(order.numel(), dtype=torch.bool)
    chosen[order[:count]] = True
    return chosen.view(batch, cameras, height, width).to(images.device)


def _detached(gaussians: Gaussians) -> Gaussians:
    """Copy without gradient history; Adam changes values in place."""
    names = ("means", "scales", "quats", "opacities", "harmonics")
    return replace(
        gaussians, **{name: getattr(gaussians, name).detach().clone() for name in names}
    )
