"""The colour transform of one region, its blend into the photo, and the faults of an editor
(section 3.2 and 4.4).

Every step of the transform maps a pixel's colour by itself, never by statistics of its image: only
so does a surface keep one colour in all views, whatever else each of them shows. (The usual
contrast jitter turns around the image's own mean and would not do.)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import ConfigDict, Field
from torch import Tensor

from edit3r.contract.settings import Settings
from edit3r.kit.geometry.maps import dilate

Image = Float[Tensor, "*batch 3 height width"]
Masks = Float[Tensor, "*batch height width"]
Outline = Literal["exact", "grown", "shrunk", "leaking"]

JITTERS = ("brightness", "contrast", "saturation", "hue")

# Principal components of ImageNet's RGB values in [0, 1], one row each. The offset is the sum of
# direction times eigenvalue times a normal weight (Krizhevsky et al. 2012, section 4.1).
PCA_EIGENVALUES = (0.2175, 0.0188, 0.0045)
PCA_DIRECTIONS = (
    (-0.5675, -0.5808, -0.5836),
    (0.7192, -0.0045, -0.6948),
    (0.4009, -0.8140, 0.4203),
)

EPSILON = 1e-6  # added to the sum that overlapping masks are divided by

FAULTS: tuple[Outline, ...] = ("grown", "shrunk", "leaking")
# how far a faulty outline moves [longer sides], at least a pixel; leakage twice as far
REACH = 1 / 64
LEAK = 0.5  # largest weight of the edit outside its object


class RecolorRanges(Settings):
    """How strongly colours are drawn to change: factors from [1 - x, 1 + x] (gamma: [1/g, g])."""

    brightness: float = Field(0.3, ge=0, le=1)
    """largest change of brightness [factor - 1]"""
    contrast: float = Field(0.3, ge=0, le=1)
    """largest change of contrast [factor - 1]"""
    saturation: float = Field(0.5, ge=0, le=1)
    """largest change of saturation [factor - 1]"""
    hue: float = Field(0.5, ge=0, le=0.5)
    """largest rotation of hue [turns]"""
    gamma: float = Field(1.5, ge=1, le=4)
    """largest gamma g; drawn from [1/g, g], evenly in its logarithm"""
    lighting: float = Field(0.4, ge=0, le=2)
    """standard deviation of the PCA lighting weights; 0.1 is barely visible"""
    permute_probability: float = Field(0.5, ge=0, le=1)
    """how often RGB channels change places"""
    greyscale_probability: float = Field(0.1, ge=0, le=1)
    """how often all colour is taken away"""


DEFAULT_RANGES = RecolorRanges()


@dataclass(frozen=True)
class RecolorParameters:
    """Theta_r: one region's colour transform, drawn once and used in every view, at any size."""

    brightness: float = 1.0  # factor on RGB
    contrast: float = 1.0  # factor on the distance from mid-grey
    saturation: float = 1.0  # factor on the distance from the pixel's own grey
    hue: float = 0.0  # rotation [turns]
    order: tuple[str, ...] = JITTERS  # of the four jitters above
    gamma: float = 1.0  # exponent
    # PCA offset, as added to RGB
    lighting: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # output channel c is input channel permutation[c]
    permutation: tuple[int, int, int] = (0, 1, 2)
    greyscale: bool = False
    # of a recipe that is read from a file
    __pydantic_config__ = ConfigDict(extra="forbid")

    def __post_init__(self) -> None:
        if sorted(self.order) != sorted(JITTERS):
            raise ValueError(
                f"RecolorParameters.order: expected each of {JITTERS} once, got {self.order}"
            )
        if sorted(self.permutation) != [0, 1, 2]:
            raise ValueError(
                "RecolorParameters.permutation: expected an order of 0, 1, 2, got "
                f"{self.permutation}"
            )


def sample_parameters(
    generator: torch.Generator, ranges: RecolorRanges
) -> RecolorParameters:
    """Draw Theta_r for one region; the generator alone decides, whatever the images are."""

    def around(centre: float, width: float) -> float:
        return centre + width * (
            2 * torch.rand((), generator=generator, dtype=torch.float64).item() - 1
        )

    def chance(probability: float) -> bool:
        return torch.rand((), generator=generator).item() < probability

    order = torch.randperm(4, generator=generator).tolist()
    permutation = torch.randperm(3, generator=generator).tolist()
    return RecolorParameters(
        brightness=around(1, ranges.brightness),
        contrast=around(1, ranges.contrast),
        saturation=around(1, ranges.saturation),
        hue=around(0, ranges.hue),
        order=tuple(JITTERS[index] for index in order),
        gamma=ranges.gamma ** around(0, 1),
        lighting=_lighting_offset(generator, ranges.lighting),
        permutation=tuple(permutation)
        if chance(ranges.permute_probability)
        else (0, 1, 2),
        greyscale=chance(ranges.greyscale_probability),
    )


def visible_parameters(
    rng: np.random.Generator,
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "view height width"],
    least: float = 0.08,
    tries: int = 8,
    ranges: RecolorRanges = DEFAULT_RANGES,
) -> RecolorParameters:
    """Parameters of a mean change of at least `least` in `masks`, or the strongest of `tries`."""
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    images, masks = images[..., ::4, ::4], masks[..., ::4, ::4]  # enough to judge by
    weight = masks[:, None] / (3 * masks.sum()).clamp(min=1e-6)
    best, best_change = RecolorParameters(), -1.0
    for _ in range(tries):
        parameters = sample_parameters(generator, ranges)
        change = float(((recolor(images, parameters) - images).abs() * weight).sum())
        if change > best_change:
            best, best_change = parameters, change
        if change >= least:
            break
    return best


def recolor(image: Image, parameters: RecolorParameters) -> Image:
    """C_Theta: jitters in their order, gamma, lighting, permutation, greyscale; sRGB in [0, 1]."""
    for name in parameters.order:
        image = _JITTER[name](image, getattr(parameters, name)).clamp(0, 1)
    image = image**parameters.gamma
    image = (image + image.new_tensor(parameters.lighting)[:, None, None]).clamp(0, 1)
    image = image[..., list(parameters.permutation), :, :]
    return to_greyscale(image) if parameters.greyscale else image


def recolored(
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "region view height width"],
    parameters: Sequence[RecolorParameters],
) -> Float[Tensor, "view 3 height width"]:
    """Recolour region r of every view with `parameters[r]` and blend it softly."""
    return blend_regions(
        images, torch.stack([recolor(images, p) for p in parameters]), masks
    ).clamp(0, 1)


def blend_regions(
    image: Float[Tensor, "*batch 3 height width"],
    recolored: Float[Tensor, "region *batch 3 height width"],
    masks: Float[Tensor, "region *batch height width"],
) -> Float[Tensor, "*batch 3 height width"]:
    """I' = sum_r a_r C_r(I) + (1 - sum_r a_r) I (section 3.2), exact where no mask is."""
    weights = renormalize(masks).unsqueeze(-3)
    return (weights * recolored).sum(0) + (1 - weights.sum(0)) * image


def renormalize(
    masks: Float[Tensor, "region *batch height width"],
) -> Float[Tensor, "region *batch height width"]:
    """Scale the masks of every pixel so that they sum to at most one.

    The paper divides by the sum "when regions overlap" and states that a single region is plain
    alpha blending, so a sum below one is left alone: the soft edge of a mask stays soft.
    """
    total = masks.sum(0)
    return torch.where(total > 1, masks / (total + EPSILON), masks)


def adjust_contrast(image: Image, factor: float) -> Image:
    """Scale the distance from mid-grey; the result may leave [0, 1]."""
    return 0.5 + factor * (image - 0.5)


def adjust_saturation(image: Image, factor: float) -> Image:
    """Scale the distance from the pixel's own grey; the result is in [0, 1]."""
    return ((1 - factor) * to_greyscale(image) + factor * image).clamp(0, 1)


def to_greyscale(image: Image) -> Image:
    """Put the luma into all three channels."""
    red, green, blue = image.unbind(-3)
    return (0.299 * red + 0.587 * green + 0.114 * blue).unsqueeze(-3).expand_as(image)


def _brightness(image: Image, factor: float) -> Image:
    return image * factor


def _hue(image: Image, turns: float) -> Image:
    from kornia.enhance import adjust_hue  # loading kornia takes a quarter of a second

    return adjust_hue(image, 2 * math.pi * turns) if turns else image


_JITTER = {
    "brightness": _brightness,
    "contrast": adjust_contrast,
    "saturation": adjust_saturation,
    "hue": _hue,
}


def _lighting_offset(
    generator: torch.Generator, deviation: float
) -> tuple[float, float, float]:
    weights = deviation * torch.randn(3, generator=generator, dtype=torch.float64)
    scaled = weights * torch.tensor(PCA_EIGENVALUES, dtype=torch.float64)
    return tuple((scaled @ torch.tensor(PCA_DIRECTIONS, dtype=torch.float64)).tolist())


def draw_outline(rng: np.random.Generator) -> Outline:
    """Draw one of the three faults of an outline, evenly.

    Section 4.4 names "SAM2-derived mask jittering (dilation/erosion), palette perturbation, and
    limited background leakage" without amounts; the amounts here are this project's own.
    """
    return FAULTS[rng.integers(3)]


def with_outline(masks: Masks, outline: Outline) -> Masks:
    """Grow or shrink masks, or let some of the edit leak around them; soft edges stay soft."""
    reach = max(1, round(REACH * max(masks.shape[-2:])))
    if outline == "grown":
        return dilate(masks, reach)
    if outline == "shrunk":
        return -dilate(-masks, reach)
    if outline == "leaking":
        flat = masks.reshape(-1, 1, *masks.shape[-2:])
        blurred = F.avg_pool2d(
            flat, 4 * reach + 1, stride=1, padding=2 * reach
        ).reshape(masks.shape)
        return torch.maximum(masks, LEAK * blurred)
    return masks


def perturbed(
    parameters: RecolorParameters, rng: np.random.Generator, amount: float = 0.08
) -> RecolorParameters:
    """An edit's palette shifted: factors times 1 +- `amount`, hue by at most amount / 4 turns."""
    *shifts, hue = rng.uniform(-amount, amount, 5).tolist()
    factors = {
        name: getattr(parameters, name) * (1 + shift)
        for name, shift in zip(
            ("brightness", "contrast", "saturation", "gamma"), shifts
        )
    }
    return replace(parameters, hue=parameters.hue + hue / 4, **factors)
