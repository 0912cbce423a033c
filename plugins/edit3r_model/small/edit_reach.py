"""Where an edit may be carried to, so that all else stays the photo's own, bit for bit."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.morphology import dilate
from edit3r.geometry.warping import Correspondences, warp
from edit3r_model.small.local_colour import blur

_CHANGE = 2 / 255
"""A change below this [sRGB] counts in proportion."""

_SAME_SURFACE = 0.05
"""Largest difference of log depth at which a pixel and its place in the reference are taken for one surface."""

_ALIKE = 0.1
"""Mean difference of colours [sRGB] above which the two photos do not show one surface, whatever the depths say."""

_SPREAD = 0.02
"""How far around a change an edit may be carried [long sides]: outlines and matches are off by some pixels."""


def near_an_edit(
    edited: Float[Tensor, "batch view 3 height width"],
    photos: Float[Tensor, "batch view 3 height width"],
    matches: Correspondences,
    measured: Bool[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view height width"]:
    """Where something may be carried to: 1 near a change, 0 where no picture shows any, exactly.

    The reference tells of the surfaces that it surely shows, the view's own picture of all. A picture that was not
    edited at all tells nothing, and what the reference does not show of it stays open.
    """
    reach = max(1, round(_SPREAD * max(photos.shape[-2:])))
    speck = -(-reach // 5)
    change = (edited - photos).abs().amax(2, keepdim=True)
    reference = torch.cat((photos[:, :1], change[:, :1]), 2).expand(-1, photos.shape[1], -1, -1, -1)
    colours, of_reference = warp(reference, matches.coordinates).split((3, 1), 2)
    apart = _spread((colours - photos).abs().amax(2), reach / 5)
    seen = matches.inside * (measured & (matches.depth_ratio.abs() < _SAME_SURFACE) & (apart < _ALIKE))
    change, of_reference = change[:, :, 0], of_reference[:, :, 0] * seen
    # Without specks, which chance made alike.
    of_reference = dilate(-dilate(-of_reference, speck), speck)
    untouched = (change.amax((2, 3), keepdim=True) == 0) & (change[:, :1].amax((2, 3), keepdim=True) > 0)
    unknown = untouched & (seen == 0)
    found = torch.maximum(change, of_reference).clamp(max=_CHANGE) / _CHANGE
    found = _spread(dilate(found, reach), reach / 4)
    return torch.maximum(found, unknown.to(found.dtype))


def _spread(maps: Float[Tensor, "batch view height width"], sigma: float) -> Float[Tensor, "batch view height width"]:
    return blur(maps.flatten(0, 1)[:, None], sigma)[:, 0].unflatten(0, maps.shape[:2])
