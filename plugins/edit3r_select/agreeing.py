"""What most photos show of a thing holds in all: no nose without the colour of its bear.

A mask that was carried to another photo is drawn anew there, by what that photo shows. It may miss
a snout before a dark wood, or take a rock along, and a click may do so in its own photo. In 3D both
colours then stand at one place. Where depth was measured in several photos and says that they show
one surface, they vote on it. Only patches count: outlines never lie at the same pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass

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
GAP = 0.1  # between a mask that may end too early and a border [longer sides]
SEVERAL = 3  # photos of a place from which one that was marked counts twice
CARRIED, FOUND, EXACT = 1, 2, 100
"""How much a mask counts that was carried to its photo, was found there by marks or words, or was
given: nothing outvotes that.
"""

Mask = Float[Tensor, "height width"]


@dataclass(frozen=True)
class Told:
    """What one photo says of the pixels of a view."""

    mask: Mask
    says: Bool[Tensor, "height width"]  # where it says anything
    weight: int  # CARRIED, FOUND or EXACT


def of_itself(mask: Mask, weight: int) -> Told:
    """What a view says of itself."""
    says = torch.ones_like(mask, dtype=torch.bool)
    return Told(mask, says if weight == EXACT else ~cut_off(mask), weight)


def cut_off(mask: Mask) -> Bool[Tensor, "height width"]:
    """What lies between a mask and the photo's border where both are near: the end of a thing that
    the border cuts is often left out, so that this says nothing of it.
    """
    inside = (mask > 0.5).numpy(force=True)
    if not inside.any():
        return torch.zeros_like(mask, dtype=torch.bool)
    to_mask = cv2.distanceTransform((~inside).astype(np.uint8), cv2.DIST_L2, 5)
    framed = np.pad(np.ones_like(inside, np.uint8), 1)
    to_border = cv2.distanceTransform(framed, cv2.DIST_L2, 5)[1:-1, 1:-1]
    near = to_mask + to_border <= GAP * max(inside.shape)
    return torch.from_numpy(~inside & near).to(mask.device)


def told_by(
    source: Told,
    shared: tuple[Float[Tensor, "height width 2"], Bool[Tensor, "height width"]],
    confidence: Float[Tensor, "2 height width"],
) -> Told:
    """What another photo says of a view.

    `shared` is where the view's pixels lie in the other, and whether both show one surface, within
    `ONE_SURFACE`; `confidence` is that of the depths of both.
    """
    grid, same = shared
    here, there = confidence >= MEASURED
    layers = torch.stack((source.mask, (there & source.says).to(source.mask)))
    mask, known = warp(layers, grid, padding="zeros")
    return Told(mask, same & here & (known > SURELY), source.weight)


def agreed(own: Told, others: Sequence[Told]) -> Mask:
    """The mask of a view with its patches as most photos have them; half of them are enough."""
    said = (own, *others)
    masks = torch.stack([one.mask for one in said])
    says = torch.stack([one.says for one in said])
    counts = torch.tensor([one.weight for one in said], device=masks.device)
    weights = says * counts[:, None, None]
    few = says.sum(0) < SEVERAL
    weights = torch.where(few & (weights == FOUND), CARRIED, weights)
    wanted = 2 * (weights * (masks > 0.5)).sum(0) >= weights.sum(0)
    told = says[1:].any(0)
    near = told & _about_patches(told & (wanted != (own.mask > 0.5)))
    most = torch.where(says, masks, 0).amax(0)
    least = torch.where(says, masks, 1).amin(0)
    return torch.where(near, torch.where(wanted, most, least), own.mask)


def _about_patches(where: Bool[Tensor, "height width"]) -> Bool[Tensor, "height width"]:
    """The pixels in and about what is as wide as a disc of radius `THIN`, with its soft edge."""
    radius = max(1, round(THIN * max(where.shape)))
    core = cv2.erode(where.numpy(force=True).astype(np.uint8), _disc(radius))
    return torch.from_numpy(cv2.dilate(core, _disc(2 * radius)) > 0).to(where.device)


def _disc(radius: int) -> np.ndarray:
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1,) * 2)
