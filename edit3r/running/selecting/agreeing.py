"""What one photo shows of a thing holds in the others: no nose without the colour of its bear.

A mask that was carried to another photo is drawn anew there, by what that photo shows, and a snout
before a dark wood may be missed. In 3D both colours then stand at one place. Where depth was
measured in both photos and says that they show one surface, what belongs to the thing in the photo
that was marked belongs to it there too. Only patches count: outlines never lie at the same pixel.
Nothing is taken away: a first mask that holds too little would spoil one that is right.
"""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.kit.geometry.warping import warp

ONE_SURFACE = 0.03  # relative difference in depth within which two photos show one
MEASURED = 0.5  # confidence from which a depth was measured
SURELY = 0.99  # share of four pixels whose depth was measured
THIN = 0.012  # radius of the disc that fits into what is a patch [longer sides]

Mask = Float[Tensor, "height width"]


def agreed(
    mask: Mask,
    source: Mask,
    shared: tuple[Float[Tensor, "height width 2"], Bool[Tensor, "height width"]],
    confidence: Float[Tensor, "2 height width"],
) -> Mask:
    """The mask of a view, with the patches that it lacks of `source`, that of another one.

    `shared` is where its pixels lie in the other, and whether both show one surface, within
    `ONE_SURFACE`; `confidence` is that of the depths of both.
    """
    grid, same = shared
    here, there = (confidence >= MEASURED).to(mask)
    told, known = warp(torch.stack((source.to(mask), there)), grid, padding="zeros")
    measured = same & (here > 0) & (known > SURELY)
    lacking = measured & (told > 0.5) & (mask <= 0.5)
    near = measured & _about_patches(lacking)
    return torch.where(near, torch.maximum(told, mask), mask)


def _about_patches(where: Bool[Tensor, "height width"]) -> Bool[Tensor, "height width"]:
    """The pixels in and about what is as wide as a disc of radius `THIN`, with its soft edge."""
    radius = max(1, round(THIN * max(where.shape)))
    core = cv2.erode(where.numpy(force=True).astype(np.uint8), _disc(radius))
    return torch.from_numpy(cv2.dilate(core, _disc(2 * radius)) > 0).to(where.device)


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
