"""From the network's decisions to one Gaussian per photo pixel, at the photo's own resolution and sharpness."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.geometry.unproject import pixel_scales, pixels_to_gaussians
from edit3r.geometry.upsampling import guided_upsample
from edit3r.geometry.warping import Correspondences, find_correspondences, partner_views, warp
from edit3r.interfaces import MatchedGeometry
from edit3r.types import Cameras, Reconstruction, Views
from edit3r_model.small.edit_reach import near_an_edit
from edit3r_model.small.local_colour import blur, change_of
from edit3r_model.small.network import NetworkOutputs

VISIBLE_CHANGE = 0.05
"""A change of the reference below this [sRGB] counts in proportion: no edit there, no colour taken from there."""

MEASURED = 0.5
"""Confidence below which a depth was filled in."""


@dataclass(frozen=True)
class AssemblySettings:
    """How matched geometry becomes Gaussians before the network's corrections."""

    footprint: float = 0.35  # standard deviation [pixels]
    opacity: float = 0.6  # of measured points; below 1 so that the views blend
    filled_opacity: float = 0.45  # of filled-in points
    lone_opacity: float = 0.8  # of filled-in points whose place the partner does not show
    floating_opacity: float = 0.02  # of filled-in points in front of what the partner surely sees
    fuse_edits: bool = True  # False: every view shows its own edited colours


def assemble(
    edited: Views, source: Views, geometry: MatchedGeometry, outputs: NetworkOutputs, settings: AssemblySettings
) -> Reconstruction:
    """Gaussians of every view in the frame of view 0, in the matcher's unit of length."""
    photos = source.images
    fine = _at_photo_size(outputs, photos)
    depths = geometry.depths * fine.depth_correction.exp()
    matches = find_correspondences(depths, source.intrinsics, geometry.c2w)
    colours, logits = edited.images, _opacity_logits(geometry, matches, settings) + fine.opacity_correction
    if settings.fuse_edits:
        near = near_an_edit(edited.images, photos, matches, geometry.confidence >= MEASURED)
        colours = fuse_colours(edited.images, photos, fine, matches, near)
        logits = logits + near * fine.disagreement
    opacities = torch.sigmoid(logits)
    scales = pixel_scales(depths, source.intrinsics, settings.footprint) * fine.scale_correction.exp()
    cameras = Cameras(geometry.c2w, source.intrinsics, source.image_size)
    return Reconstruction(pixels_to_gaussians(colours, depths, cameras, scales, opacities), cameras)


def fuse_colours(
    edited: Float[Tensor, "batch view 3 height width"],
    photos: Float[Tensor, "batch view 3 height width"],
    outputs: NetworkOutputs,
    matches: Correspondences,
    near: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 3 height width"]:
    """Convex mix of the candidates; exactly `edited` where it is not `near` a change."""
    shape = photos.shape[:2]
    carried = (photos + change_of(outputs.maps.flatten(0, 1), photos.flatten(0, 1)).unflatten(0, shape)).clamp(0, 1)
    reference = torch.cat((edited[:, :1], (edited - photos)[:, :1]), 2).expand(-1, shape[1], -1, -1, -1)
    pulled, change = warp(reference, matches.coordinates).split(3, 2)
    presence = blur(change.abs().amax(2).flatten(0, 1)[:, None], 1.0).unflatten(0, shape)
    presence = (presence / VISIBLE_CHANGE).clamp(max=1) * matches.inside[:, :, None]
    choice = outputs.choice * near[:, :, None]
    taken = choice[:, :, 2:] * presence
    # What is not taken along the geometry for want of an edit there goes to the photo under the carried map.
    mapped = choice[:, :, 1:2] + choice[:, :, 2:] - taken
    return edited + mapped * (carried - edited) + taken * (pulled - edited)


def _at_photo_size(outputs: NetworkOutputs, photos: Tensor) -> NetworkOutputs:
    """The network's maps at the photos' size, along the photos' edges."""
    single = (outputs.depth_correction, outputs.opacity_correction, outputs.scale_correction, outputs.disagreement)
    stacked = torch.cat((torch.stack(single, 2), outputs.maps, outputs.choice), 2)
    fine = guided_upsample(stacked.flatten(0, 1), photos.flatten(0, 1)).unflatten(0, photos.shape[:2])
    depth, opacity, scale, disagreement = fine[:, :, :4].unbind(2)
    choice = fine[:, :, -outputs.choice.shape[2] :]
    choice = choice / choice.sum(2, keepdim=True).clamp(min=1e-6)
    return NetworkOutputs(depth, opacity, scale, disagreement, fine[:, :, 4:-3], choice)


def _opacity_logits(geometry: MatchedGeometry, matches: Correspondences, settings: AssemblySettings) -> Tensor:
    """Honest start: less for filled-in points, next to nothing for those that float in front of the partner's."""
    filled = geometry.confidence < MEASURED
    guessed = torch.where(matches.inside.bool(), settings.filled_opacity, settings.lone_opacity)
    opacity = torch.where(filled, guessed, settings.opacity)
    seen = warp(geometry.confidence[:, partner_views(filled.shape[1]), None], matches.coordinates, mode="nearest")[
        :, :, 0
    ]
    floating = filled & (matches.depth_ratio < -0.03) & (seen > MEASURED)
    return torch.logit(torch.where(floating, settings.floating_opacity, opacity))
