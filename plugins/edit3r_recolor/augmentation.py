"""Small faults that a 2D editor makes and a clean recolouring lacks: wrong outlines, leakage, a palette a little off.

"SAM2-derived mask jittering (dilation/erosion), palette perturbation, and limited background leakage" (section 4.4 of
the paper, without its amounts; these are this project's own). A fault is drawn once and kept as data, so that it can
be replayed; outlines move in proportion to the picture, the same share at every size.
"""

from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.morphology import dilate
from edit3r_recolor.parameters import RecolorParameters

Outline = Literal["exact", "grown", "shrunk", "leaking"]
FAULTS: tuple[Outline, ...] = ("grown", "shrunk", "leaking")
REACH = 1 / 64
"""How far an outline moves [longer sides of the picture], at least a pixel; leakage reaches twice as far."""

LEAK = 0.5
"""Largest weight of the edit outside its object."""

Masks = Float[Tensor, "*batch height width"]


@dataclass(frozen=True)
class Fault:
    """What goes wrong with one region in one view."""

    outline: Outline = "exact"
    parameters: RecolorParameters | None = None  # the region's colours in this view; None: as they should be

    def to_json(self) -> dict:
        """Plain JSON data."""
        return asdict(self)

    @staticmethod
    def from_json(data: dict) -> "Fault":
        """Inverse of `to_json`."""
        given = data["parameters"]
        return Fault(data["outline"], None if given is None else RecolorParameters.from_json(given))


def draw_outline(rng: np.random.Generator) -> Outline:
    """One of the three faults, evenly."""
    return FAULTS[rng.integers(3)]


def with_outline(masks: Masks, outline: Outline) -> Masks:
    """The masks grown, shrunk, or with a little of the edit in the background; their soft edges stay soft."""
    reach = max(1, round(REACH * max(masks.shape[-2:])))
    if outline == "grown":
        return dilate(masks, reach)
    if outline == "shrunk":
        return -dilate(-masks, reach)
    if outline == "leaking":
        return torch.maximum(masks, LEAK * _blurred(masks, 2 * reach))
    return masks


def perturbed(parameters: RecolorParameters, rng: np.random.Generator, amount: float = 0.08) -> RecolorParameters:
    """The same edit with its palette a little off: factors times 1 +- `amount`, hue off by at most amount / 4 turns."""
    brightness, contrast, saturation, gamma, hue = rng.uniform(-amount, amount, 5).tolist()
    return replace(
        parameters,
        brightness=parameters.brightness * (1 + brightness),
        contrast=parameters.contrast * (1 + contrast),
        saturation=parameters.saturation * (1 + saturation),
        gamma=parameters.gamma * (1 + gamma),
        hue=parameters.hue + hue / 4,
    )


def _blurred(masks: Masks, reach: int) -> Masks:
    """Mean over a square of `reach` pixels around; beyond the border counts as 0."""
    flat = masks.reshape(-1, 1, *masks.shape[-2:])
    return F.avg_pool2d(flat, 2 * reach + 1, stride=1, padding=reach).reshape(masks.shape)
