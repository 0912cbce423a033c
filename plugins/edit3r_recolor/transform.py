"""C_Theta: the composite colour transform of one region as a pure function of its parameters (section 3.2).

Every step maps a pixel's colour by itself, never by statistics of its picture: only so does a surface keep one colour
in all views, whatever else each of them shows. (The usual contrast jitter turns around the picture's own mean and
would not do.)
"""

import math

import kornia
from jaxtyping import Float
from torch import Tensor

from edit3r_recolor.parameters import RecolorParameters

Image = Float[Tensor, "*batch 3 height width"]


def recolor(image: Image, parameters: RecolorParameters) -> Image:
    """Jitters in their order, gamma, lighting offset, channel permutation, greyscale. In and out: sRGB in [0, 1]."""
    for name in parameters.order:
        image = _JITTER[name](image, getattr(parameters, name)).clamp(0, 1)
    image = kornia.enhance.adjust_gamma(image, parameters.gamma)
    image = (image + image.new_tensor(parameters.lighting)[:, None, None]).clamp(0, 1)
    image = image[..., list(parameters.permutation), :, :]
    return to_greyscale(image) if parameters.greyscale else image


def adjust_contrast(image: Image, factor: float) -> Image:
    """Scale the distance from mid-grey; may leave [0, 1]."""
    return 0.5 + factor * (image - 0.5)


def adjust_saturation(image: Image, factor: float) -> Image:
    """Scale the distance from the pixel's own grey; the result is in [0, 1]."""
    return kornia.enhance.adjust_saturation_with_gray_subtraction(image, factor)


def to_greyscale(image: Image) -> Image:
    """Luma in all three channels."""
    return kornia.color.rgb_to_grayscale(image).expand_as(image)


def _brightness(image: Image, factor: float) -> Image:
    return image * factor


def _hue(image: Image, turns: float) -> Image:
    return kornia.enhance.adjust_hue(image, 2 * math.pi * turns) if turns else image


_JITTER = {"brightness": _brightness, "contrast": adjust_contrast, "saturation": adjust_saturation, "hue": _hue}
