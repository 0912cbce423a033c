"""Views before and after an edit, beside the reference's edit as each of them would show it, and
where each pixel lies in a partner view.

Photos of one place differ in exposure and white balance. Gain and offset of each channel are read
from the places that view and reference both surely show.
"""

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.kit.geometry.cameras import project, unproject
from edit3r.kit.geometry.warping import SAME_SURFACE, warp

CHANGE = 2 / 255
"""A change below this [sRGB] counts in proportion."""

ALIKE = 0.1
"""Mean difference of colours [sRGB] above which two images do not show one surface, whatever the
depths say. No figure kept.
"""

FITS = 6
"""Rounds of the robust fits."""

MIN_VARIANCE = 1e-3
"""Of colours [sRGB^2]: keeps the gain of a plain image near 1."""

Images = Float[Tensor, "batch view 3 height width"]
Maps = Float[Tensor, "batch view height width"]
Exposure = Float[Tensor, "batch view 6 1 1"]


@dataclass(frozen=True)
class Correspondences:
    """Where each pixel of each view lies in the view's partner (see `partner_views`)."""

    # normalised (x, y) in the partner's image
    coordinates: Float[Tensor, "batch view height width 2"]
    # 1: in front of the partner and within its image, else 0
    inside: Float[Tensor, "batch view height width"]
    # log(own depth there / partner's depth), in [-1, 1]
    depth_ratio: Float[Tensor, "batch view height width"]


def partner_views(views: int) -> list[int]:
    """The view that each of `views` views is compared with: view 0, and view 1 for view 0."""
    return [1] + [0] * (views - 1)


def find_correspondences(
    depths: Float[Tensor, "batch view height width"],
    intrinsics: Float[Tensor, "batch view 3 3"],
    c2w: Float[Tensor, "batch view 4 4"],
) -> Correspondences:
    """Project each view's depth map into its partner; `depths` are camera z."""
    batch, views, height, width = depths.shape
    partners = partner_views(views)
    points = unproject(depths, intrinsics, c2w).reshape(batch, views, height * width, 3)
    coordinates, z = project(points, intrinsics[:, partners], c2w[:, partners])
    coordinates = coordinates.unflatten(2, (height, width))
    z = z.view_as(depths)
    inside = ((z > 1e-6) & (coordinates > 0).all(-1) & (coordinates < 1).all(-1)).to(
        depths.dtype
    )
    coordinates = torch.where(
        (z > 1e-6)[..., None], coordinates, torch.full_like(coordinates, -1)
    ).clamp(-1, 2)
    seen = warp(depths[:, partners, None], coordinates, mode="nearest")[:, :, 0]
    ratio = torch.log(z.clamp(min=1e-6) / seen.clamp(min=1e-6)).clamp(-1, 1)
    return Correspondences(coordinates, inside, ratio * inside)


@dataclass(frozen=True)
class EditedViews:
    """Views before and after the edit; `before` and `after` are the reference's images as each view
    would show them.
    """

    source: Images
    edited: Images
    before: Images
    after: Images
    matches: Correspondences

    @staticmethod
    def of(
        edited: Images, source: Images, exposure: Exposure, matches: Correspondences
    ) -> "EditedViews":
        """Show the reference with the exposure and white balance of each view."""
        gain, offset = exposure.split(3, 2)
        before = (gain * source[:, :1] + offset).clamp(0, 1)
        after = (gain * edited[:, :1] + offset).clamp(0, 1)
        return EditedViews(source, edited, before, after, matches)

    @cached_property
    def change(self) -> Images:
        """What the edit did to each view."""
        return self.edited - self.source

    @cached_property
    def reference(self) -> tuple[Images, Images]:
        """`before` and `after` at the places that correspond to each view's pixels."""
        both = torch.cat((self.before, self.after), 2)
        return warp(both, self.matches.coordinates).split(3, 2)

    @property
    def reach(self) -> int:
        """How far around a change an edit may be carried [pixels]: outlines and matches are off."""
        return max(1, round(0.02 * max(self.source.shape[-2:])))

    @property
    def speck(self) -> int:
        """Size of what is left out as chance [pixels]."""
        return -(-self.reach // 5)


def find_exposure(
    source: Images,
    matches: Correspondences,
    measured: Bool[Tensor, "batch view height width"],
) -> Exposure:
    """Return gain and offset of each channel from the reference's colours to each view's.

    They give the colours at matched places the same mean and spread, by moments that are reweighted
    robustly (Cauchy weights). Exactly 1 and 0 for the reference, and where that takes less than a
    third off the difference.
    """
    there = warp(source[:, :1].expand_as(source), matches.coordinates)
    same = measured & (matches.depth_ratio.abs() < SAME_SURFACE)
    seen = (matches.inside * same)[:, :, None]
    weights = seen
    for _ in range(FITS):
        share = weights / _total(weights).clamp(min=1e-6)
        mean, mean_own = _total(share * there), _total(share * source)
        variance = _total(share * (there - mean).square())
        variance_own = _total(share * (source - mean_own).square())
        gain = ((variance_own + MIN_VARIANCE) / (variance + MIN_VARIANCE)).sqrt()
        left = gain * (there - mean) + mean_own - source
        left = left.abs().amax(2, keepdim=True)
        weights = seen / (1 + (left / ALIKE).square())
    unlike = (there - source).abs().amax(2, keepdim=True)
    explained = _total(seen * left) < 2 / 3 * _total(seen * unlike)
    explained[:, 0] = False
    none = torch.cat((torch.ones_like(gain), torch.zeros_like(gain)), 2)
    return torch.where(explained, torch.cat((gain, mean_own - gain * mean), 2), none)


def _total(x: Tensor) -> Tensor:
    """The sum over each image."""
    return x.sum((3, 4), keepdim=True)
