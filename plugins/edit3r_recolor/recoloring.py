"""Region-wise recolouring of pictures of one scene: parameters that show, and their soft blend (section 3.2)."""

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r_recolor.blend import blend_regions
from edit3r_recolor.parameters import RecolorParameters, RecolorRanges, sample_parameters
from edit3r_recolor.transform import recolor

DEFAULT_RANGES = RecolorRanges()


def visible_parameters(
    rng: np.random.Generator,
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "view height width"],
    least: float = 0.08,
    tries: int = 8,
    ranges: RecolorRanges = DEFAULT_RANGES,
) -> RecolorParameters:
    """Parameters whose mean absolute change inside `masks` is at least `least`, or the strongest of `tries`."""
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


def recolored(
    images: Float[Tensor, "view 3 height width"],
    masks: Float[Tensor, "region view height width"],
    parameters: Sequence[RecolorParameters],
) -> Float[Tensor, "view 3 height width"]:
    """Region r of every view under `parameters[r]`, softly blended."""
    return blend_regions(images, torch.stack([recolor(images, p) for p in parameters]), masks).clamp(0, 1)
