"""The part of a region that has a colour: "only the red parts", "from grey to brown"."""

import cv2
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.errors import PromptError
from edit3r.contract.instructions import Colour
from edit3r.kit.compute.colour import rgb_to_lab

# The numbers of this block: no figures kept.
NEAR, FAR = 13.0, 20.0
"""Differences up to which a pixel has the colour, and from which it has not."""
LIGHTNESS_WEIGHT, HUE_WEIGHT = 0.5, 1.7
"""Shade changes lightness, and names are about hue: the weights of both in the difference."""
NEAR_HUE, FAR_HUE = 12.0, 20.0
"""The same for the hue of what joins that [degrees]."""
LIGHTER = 10.0
"""Lightness above the named colour's, at which hues may be twice as far apart."""
MOST_OF_A_PIECE = 0.6
MIN_CHROMA_SHARE = 0.2
"""Share of the named colour's chroma that there must be: grey is never red."""


def near_colour(
    masks: Float[Tensor, "view height width"],
    images: Float[Tensor, "view 3 height width"],
    colour: Colour,
) -> Float[Tensor, "view height width"]:
    """The part of soft `masks` whose pixels are near a named colour.

    By CIE94 around the named colour, which allows the more difference in chroma the more chroma the
    name has, since things are duller than the names of their colours. Within a thing, its own shade
    of the colour counts too: what is near the median of what was near. In whole photos that drifts
    from a red tank to brown wood. Raises PromptError where nothing is near.
    """
    lab = rgb_to_lab(_smoothed(images)).double()
    named = rgb_to_lab(lab.new_tensor(colour.rgb)[:, None, None])
    least = MIN_CHROMA_SHARE * named[1:].norm()
    chroma = lab[:, 1:].norm(dim=1)
    coloured = (4 * (chroma - least) / least.clamp(min=4) + 1).clamp(0, 1)
    near = _close(lab, named) * coloured
    shade = named
    for _ in range(2 if bool((masks < 0.5).any()) else 0):
        has = near * masks > 0.5
        if bool(has.any()):
            shade = lab.movedim(1, 0)[:, has].median(dim=1).values[:, None, None]
            near = coloured * torch.maximum(_close(lab, named), _close(lab, shade))
    # a highlight mixes the paint's hue with that of the light
    lighter = ((lab[:, 0] - named[0]) / LIGHTER).clamp(0, 1)
    apart = _hue_apart(lab, shade) / (1 + lighter)
    shares = _with_shades(near, apart, coloured)
    found = masks * shares.to(masks)
    if not found.any():
        raise PromptError(
            f"nothing there is near {colour.name}, so nothing would change; name the colour it has."
        )
    return found


def _close(lab: Tensor, colour: Tensor) -> Tensor:
    """1 for what has a colour, 0 for what has another."""
    return ((FAR - _difference(lab, colour)) / (FAR - NEAR)).clamp(0, 1)


def _with_shades(near: Tensor, apart: Tensor, coloured: Tensor) -> Tensor:
    """What has the colour, with what joins it in its hue: shade at the rim, a paler stripe.

    Where most of a piece of one hue has not the colour, the rest of it has another one.
    """
    hue = coloured * ((FAR_HUE - apart) / (FAR_HUE - NEAR_HUE)).clamp(0, 1)
    whole = near.clone()
    for view, pieces in enumerate((hue > 0.5).numpy(force=True).astype(np.uint8)):
        labels = cv2.connectedComponents(pieces, connectivity=4)[1]
        flat = labels.ravel()
        has = np.bincount(flat, (near[view] > 0.5).numpy(force=True).ravel())
        taken = has > MOST_OF_A_PIECE * np.bincount(flat)
        taken[0] = False
        inside = torch.from_numpy(taken[labels]).to(near.device)
        whole[view] = torch.where(inside, torch.maximum(near, hue)[view], near[view])
    return whole


def _hue_apart(
    lab: Float[Tensor, "view 3 height width"], named: Float[Tensor, "3 1 1"]
) -> Float[Tensor, "view height width"]:
    """How far the hue is from that of the name [degrees]."""
    apart = torch.atan2(lab[:, 2], lab[:, 1]) - torch.atan2(named[2], named[1])
    return torch.rad2deg((apart + np.pi).remainder(2 * np.pi) - np.pi).abs()


def _smoothed(
    images: Float[Tensor, "view 3 height width"],
) -> Float[Tensor, "view 3 height width"]:
    """The median of 3 x 3 pixels, so that noise does not decide."""
    pixels = (images.movedim(1, -1) * 255).round().to(torch.uint8).numpy(force=True)
    smooth = np.stack([cv2.medianBlur(np.ascontiguousarray(one), 3) for one in pixels])
    return torch.from_numpy(smooth).movedim(-1, 1).to(images) / 255


def _difference(
    lab: Float[Tensor, "view 3 height width"], named: Float[Tensor, "3 1 1"]
) -> Float[Tensor, "view height width"]:
    """CIE94 (McDonald and Smith 1995) with weights for lightness and hue; reference is the name."""
    lightness = lab[:, 0] - named[0]
    chroma_named = named[1:].norm()
    chroma = lab[:, 1:].norm(dim=1) - chroma_named
    hue_squared = ((lab[:, 1:] - named[1:]).square().sum(1) - chroma.square()).clamp(
        min=0
    )
    return torch.sqrt(
        (LIGHTNESS_WEIGHT * lightness).square()
        + (chroma / (1 + 0.045 * chroma_named)).square()
        + hue_squared * (HUE_WEIGHT / (1 + 0.015 * chroma_named)).square()
    )
