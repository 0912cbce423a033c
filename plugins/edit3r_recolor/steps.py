"""The colour changes that a prompt can ask for, and how each is carried out alike on all views of a
scene.
"""

import numpy as np
import torch
from jaxtyping import Float, Num
from torch import Tensor

from edit3r.compute.colour import lab_to_rgb, rgb_to_lab
from edit3r.contract.wishes import Change
from edit3r_recolor.recoloring import (
    RecolorParameters,
    adjust_contrast,
    adjust_saturation,
    recolor,
    to_greyscale,
)

PAINT_LIGHTNESS = (
    10.0,
    95.0,
)  # CIE L* of the blackest and whitest paint; beyond there is no room for shading
KEPT_CHROMA = (
    0.12  # share of the region's own colour variation that shows through paint
)
WARM_GAIN = (1.12, 1.0, 0.82)  # RGB gains of "warmer"
SEPIA = ((0.393, 0.769, 0.189), (0.349, 0.686, 0.168), (0.272, 0.534, 0.131))
Images = Float[Tensor, "view 3 height width"]
Masks = Float[Tensor, "view height width"]


def apply_change(
    images: Images, masks: Masks, change: Change, parameters: RecolorParameters
) -> Images:
    """Change whole images; `masks` only say where a paint measures the lightness it starts from."""
    if change.kind == "paint":
        return paint(images, masks, change.colour.rgb)
    if change.kind == "tint":
        return tint(images, change.colour.rgb, change.amount)
    if change.kind == "random":
        return recolor(images, parameters)
    return adjust(images, change.kind, change.amount)


def paint(images: Images, masks: Masks, rgb: tuple[float, float, float]) -> Images:
    """Colour the surfaces under `masks` as if painted with `rgb`: shading, texture and highlights
    stay.

    Works in CIE Lab. A monotone curve moves the region's median lightness, measured once over all
    views, to the paint's, with its contrast where there is room. Chroma follows the paint in
    proportion to lightness below the median, as on a diffuse surface in shade, and fades to white
    above it, as in a highlight.
    """
    lab = rgb_to_lab(images)
    target = rgb_to_lab(images.new_tensor(rgb)[:, None, None])
    weights = masks if float(masks.sum()) > 0 else torch.ones_like(masks)
    start = weighted_median(lab[:, 0], weights)
    goal = min(max(float(target[0]), PAINT_LIGHTNESS[0]), PAINT_LIGHTNESS[1])
    lightness = _lightness_curve(lab[:, 0], start, goal)
    shade = (lightness / goal).clamp(max=1) * ((100 - lightness) / (100 - goal)).clamp(
        0, 1
    )
    mean = (lab[:, 1:] * weights[:, None]).sum((0, 2, 3), keepdim=True) / weights.sum()
    chroma = shade[:, None] * target[None, 1:] + KEPT_CHROMA * shade[:, None] * (
        lab[:, 1:] - mean
    )
    return lab_to_rgb(torch.cat((lightness[:, None], chroma), 1)).clamp(0, 1)


def _lightness_curve(lightness: Masks, start: float, goal: float) -> Masks:
    """Map lightness by a monotone curve through (start, goal) of slope about 1 that stays inside
    [0, 100].
    """
    start = min(max(start, 1.0), 99.0)
    ends = max(0.0, goal - 1.2 * start), min(100.0, goal + 1.2 * (100 - start))
    places, heights = np.array([0.0, start, 100.0]), np.array([ends[0], goal, ends[1]])
    widths, slopes = np.diff(places), np.diff(heights) / np.diff(places)
    # Slopes at the three places that keep it monotone (Fritsch and Butland 1984), then a cubic on
    # either side.
    shares = (widths + widths.sum())[::-1]
    middle = shares.sum() / (shares / slopes).sum()
    outer = np.maximum(slopes + widths * (slopes - slopes[::-1]) / widths.sum(), 0)
    first, last = np.array([outer[0], middle]), np.array([middle, outer[1]])
    third = (first + last - 2 * slopes) / widths
    cubic = np.stack(
        [heights[:-1], first, (slopes - first) / widths - third, third / widths]
    )
    values = np.clip(lightness.detach().cpu().numpy(), 0, 100)
    side = (values >= start).astype(int)
    step = values.astype(np.float64) - places[side]
    return torch.from_numpy(
        sum(cubic[power][side] * step**power for power in range(4))
    ).to(lightness)


def weighted_median(
    values: Float[Tensor, "*shape"], weights: Num[Tensor, "*shape"]
) -> float:
    """Find the value with half of the weight below it; weights are >= 0 and have a positive sum."""
    ordered, index = values.flatten().sort()
    total = weights.flatten()[index].double().cumsum(0)
    return float(ordered[int(torch.searchsorted(total, total[-1:] / 2))])


def tint(images: Images, rgb: tuple[float, float, float], amount: float) -> Images:
    """Move chroma `amount` of the way to that of `rgb`; lightness stays."""
    lab = rgb_to_lab(images)
    goal = rgb_to_lab(images.new_tensor(rgb)[:, None, None])[1:]
    room = (
        (1 - (lab[:, :1] / 50 - 1).abs()).clamp(0, 1).sqrt()
    )  # black stays black, white stays white
    chroma = lab[:, 1:] + amount * room * (goal - lab[:, 1:])
    return lab_to_rgb(torch.cat((lab[:, :1], chroma), 1)).clamp(0, 1)


def adjust(images: Images, what: str, amount: float) -> Images:
    """Change one property of all colours; `amount` 1 is clearly visible, a negative one goes the
    other way.
    """
    match what:
        case "brightness":  # a gamma keeps black, white and their detail
            changed = images**2 ** (-0.7 * amount)
        case "contrast":
            changed = adjust_contrast(images, 1.45**amount)
        case "saturation":
            changed = adjust_saturation(
                images, 1.8**amount if amount > 0 else 0.4**-amount
            )
        case "warmth":
            changed = _warmer(images, amount)
        case "greyscale":
            changed = to_greyscale(images)
        case "sepia":
            changed = torch.einsum(
                "oi,...ihw->...ohw", images.new_tensor(SEPIA), images
            )
        case "invert":
            changed = 1 - images
    return changed.clamp(0, 1)


def _warmer(images: Images, amount: float) -> Images:
    """Raise the colour temperature by RGB gains; luma stays."""
    warmed = (
        images * images.new_tensor([gain**amount for gain in WARM_GAIN])[:, None, None]
    )
    return warmed * (to_greyscale(images) / to_greyscale(warmed).clamp(min=1e-6))
