"""Carry out one step of a wish on the views of a scene: every view goes through the same colour function."""

import kornia
import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from edit3r_recolor.parameters import RecolorParameters
from edit3r_recolor.transform import adjust_contrast, adjust_saturation, recolor, to_greyscale
from edit3r_recolor.wish import Adjust, Paint, Sample, Step, Tint

PAINT_LIGHTNESS = (10.0, 95.0)  # CIE L* of the blackest and whitest paint; beyond there is no room for shading
KEPT_CHROMA = 0.12  # share of the region's own colour variation that shows through paint
WARM_GAIN = (1.12, 1.0, 0.82)  # RGB gains of "warmer"

Images = Float[Tensor, "view 3 height width"]
Masks = Float[Tensor, "view height width"]


def apply_step(images: Images, masks: Masks, step: Step, parameters: RecolorParameters) -> Images:
    """The step on whole pictures. `masks` only say where a paint measures the lightness it starts from."""
    match step:
        case Paint():
            return paint(images, masks, step.rgb)
        case Tint():
            return tint(images, step.rgb, step.amount)
        case Adjust():
            return _ADJUSTMENTS[step.what](images, step.amount).clamp(0, 1)
        case Sample():
            return recolor(images, parameters)


def paint(images: Images, masks: Masks, rgb: tuple[float, float, float]) -> Images:
    """Colours as if the surfaces under `masks` had been painted with `rgb`: shading, texture and highlights stay.

    Works in CIE Lab. A monotone curve moves the region's median lightness, measured once over all views, to the
    paint's, with its contrast where there is room. Chroma follows the paint in proportion to lightness below the
    median, as on a diffuse surface in shade, and fades to white above it, as in a highlight.
    """
    lab = kornia.color.rgb_to_lab(images)
    target = kornia.color.rgb_to_lab(images.new_tensor(rgb)[:, None, None])
    weights = masks if float(masks.sum()) > 0 else torch.ones_like(masks)
    start = weighted_median(lab[:, 0], weights)
    goal = min(max(float(target[0]), PAINT_LIGHTNESS[0]), PAINT_LIGHTNESS[1])
    lightness = _lightness_curve(lab[:, 0], start, goal)
    shade = (lightness / goal).clamp(max=1) * ((100 - lightness) / (100 - goal)).clamp(0, 1)
    mean = (lab[:, 1:] * weights[:, None]).sum((0, 2, 3), keepdim=True) / weights.sum()
    chroma = shade[:, None] * target[None, 1:] + KEPT_CHROMA * shade[:, None] * (lab[:, 1:] - mean)
    return kornia.color.lab_to_rgb(torch.cat((lightness[:, None], chroma), 1)).clamp(0, 1)


def _lightness_curve(lightness: Masks, start: float, goal: float) -> Masks:
    """Monotone curve through (start, goal) with about slope 1, bent where it would leave [0, 100]."""
    start = min(max(start, 1.0), 99.0)
    ends = max(0.0, goal - 1.2 * start), min(100.0, goal + 1.2 * (100 - start))
    curve = PchipInterpolator([0.0, start, 100.0], [ends[0], goal, ends[1]])
    return torch.from_numpy(curve(np.clip(lightness.detach().cpu().numpy(), 0, 100))).to(lightness)


def weighted_median(values: Tensor, weights: Tensor) -> float:
    """The value with half of the weight below it; both of one shape, weights >= 0 with a positive sum."""
    ordered, index = values.flatten().sort()
    total = weights.flatten()[index].double().cumsum(0)
    return float(ordered[int(torch.searchsorted(total, total[-1:] / 2))])


def tint(images: Images, rgb: tuple[float, float, float], amount: float) -> Images:
    """Move chroma `amount` of the way to that of `rgb`, lightness kept."""
    lab = kornia.color.rgb_to_lab(images)
    goal = kornia.color.rgb_to_lab(images.new_tensor(rgb)[:, None, None])[1:]
    room = (1 - (lab[:, :1] / 50 - 1).abs()).clamp(0, 1).sqrt()  # black stays black, white stays white
    chroma = lab[:, 1:] + amount * room * (goal - lab[:, 1:])
    return kornia.color.lab_to_rgb(torch.cat((lab[:, :1], chroma), 1)).clamp(0, 1)


def _brightness(images: Images, amount: float) -> Images:
    return kornia.enhance.adjust_gamma(images, 2 ** (-0.7 * amount))  # a gamma keeps black, white and their detail


def _contrast(images: Images, amount: float) -> Images:
    return adjust_contrast(images, 1.45**amount)


def _saturation(images: Images, amount: float) -> Images:
    return adjust_saturation(images, 1.8**amount if amount > 0 else 0.4**-amount)


def _warmth(images: Images, amount: float) -> Images:
    """Colour temperature by RGB gains, luma kept."""
    warmed = images * images.new_tensor([gain**amount for gain in WARM_GAIN])[:, None, None]
    luma = kornia.color.rgb_to_grayscale
    return warmed * (luma(images) / luma(warmed).clamp(min=1e-6))


def _greyscale(images: Images, amount: float) -> Images:
    return to_greyscale(images)


def _sepia(images: Images, amount: float) -> Images:
    return kornia.color.sepia(images, rescale=False)


def _invert(images: Images, amount: float) -> Images:
    return 1 - images


_ADJUSTMENTS = {
    "brightness": _brightness,
    "contrast": _contrast,
    "saturation": _saturation,
    "warmth": _warmth,
    "greyscale": _greyscale,
    "sepia": _sepia,
    "invert": _invert,
}
