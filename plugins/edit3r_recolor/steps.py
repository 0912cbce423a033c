"""The colour changes that a prompt can ask for, and how each is carried out alike on all views of a
scene.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.instructions import Change
from edit3r_recolor.oklab import oklab_to_rgb, rgb_to_oklab
from edit3r_recolor.recoloring import (
    RecolorParameters,
    adjust_contrast,
    adjust_saturation,
    recolor,
    to_greyscale,
)

# The numbers of this block: no figures kept.
WARM_GAIN = (1.12, 1.0, 0.82)  # RGB gains of "warmer"
SEPIA = ((0.393, 0.769, 0.189), (0.349, 0.686, 0.168), (0.272, 0.534, 0.131))
Images = Float[Tensor, "view 3 height width"]


def apply_change(
    images: Images, change: Change, parameters: RecolorParameters
) -> Images:
    """Change whole images by anything but paint, which needs to know the thing."""
    if change.kind == "tint":
        assert change.colour is not None  # every tint has one
        return tint(images, change.colour.rgb, change.amount)
    if change.kind == "random":
        return recolor(images, parameters)
    return adjust(images, change.kind, change.amount)


def tint(images: Images, rgb: tuple[float, float, float], amount: float) -> Images:
    """Move chroma in OKLab `amount` of the way to that of `rgb`; lightness stays."""
    lab = rgb_to_oklab(images)
    lightness = lab[:, :1]
    goal = rgb_to_oklab(images.new_tensor(rgb)[:, None, None])[1:]
    room = (1 - (2 * lightness - 1).abs()).clamp(0, 1).sqrt()  # black and white stay
    chroma = lab[:, 1:] + amount * room * (goal - lab[:, 1:])
    return oklab_to_rgb(torch.cat((lightness, chroma), 1))


def adjust(images: Images, what: str, amount: float) -> Images:
    """Change one property of all colours; 1 is clearly visible, a negative one goes back."""
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
