"""Head `edit-fusion`: the edit carried from the reference to the other views, and one Gaussian per
image pixel.

features --> corrections of depth, opacity and scale features, colour maps of both images -->
EditTransport (reference -> view) --> EditFusion --> choice of colours

It decides on the backbone's grid and makes the Gaussians at the images' own resolution and
sharpness.
"""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from edit3r.config import Settings
from edit3r.contract.interfaces import Backbone, GeometryHead, MatchedGeometry
from edit3r.contract.types import Cameras, Features, Gaussians, Views
from edit3r.errors import InputError, SettingsError
from edit3r.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.geometry.maps import guided_upsample, resize
from edit3r.geometry.warping import (
    Correspondences,
    contradicted,
    find_correspondences,
    warp,
)
from edit3r_model.edit_colour import (
    blur,
    change_of,
    edits_conflict,
    edits_disagree,
    fit_colour_maps,
    looks_of,
    near_an_edit,
    shown_by_views,
)
from edit3r_model.edit_fusion import EditFusion, EditTransport, FusedEdit
from edit3r_model.small_backbone import STRIDE, averaged, upsample_to, zero_conv
from edit3r_model.surface import discs

KEY_STRIDE = 4
"""Pixels of the backbone's images per side of what the reference offers to attention."""
VISIBLE_CHANGE = 0.05
"""A change of the reference below this [sRGB] counts in proportion: no edit there, no colour taken
from there.
"""
MEASURED = 0.5
"""Confidence below which a depth was filled in."""
FLOATING_OPACITY = 0.02
"""Share of its opacity that a point keeps which other photos contradict."""


@dataclass(frozen=True)
class Decisions:
    """Corrections and choices of colour for every view, on the backbone's grid."""

    depth_correction: Float[
        Tensor, "batch view height width"
    ]  # added to log depth, in (-0.7, 0.7)
    opacity_correction: Float[Tensor, "batch view height width"]  # added to the logit
    scale_correction: Float[
        Tensor, "batch view height width"
    ]  # added to the log scale, in (-0.5, 0.5)
    looks: Float[
        Tensor, "batch view 6 1 1"
    ]  # gain and offset from the reference's colours to each view's
    maps: Float[
        Tensor, "batch view 12 height width"
    ]  # carried affine colour maps; 0 for the reference
    choice: Float[
        Tensor, "batch view 3 height width"
    ]  # weights of the candidates, together 1; 0 for the reference


class EditFusionHead(GeometryHead):
    """Corrects matched geometry, and draws edits that disagree to the reference's; starts as no
    correction.

    It reads the last level of any backbone. The Gaussians lie on the geometry's grid, whatever the
    images' size.
    """

    class Settings(Settings):
        width: int = Field(
            32,
            ge=8,
            le=512,
            multiple_of=8,
            description="channels; features of others are projected",
        )
        fuse_edits: bool = Field(
            True,
            description="false: each view keeps its own edited colours (plain reconstruction)",
        )
        depth_repair: float = Field(
            0.0,
            ge=0,
            le=1,
            description="share of the network's depth correction that counts; pictures are "
            "better without, training "
            "sets 1, so that losses on the centres move something",
        )
        opacity_repair: float = Field(
            1.0, ge=0, le=1, description="share of its corrections of opacity and size"
        )
        opacity: float = Field(0.6, gt=0, lt=1, description="before correction")
        conflict_opacity: float = Field(
            0.45,
            gt=0,
            le=1,
            description="share of its opacity that a view keeps where its edit contradicts the "
            "reference's; 1: all",
        )
        thickness: float = Field(
            0.3,
            gt=0,
            le=1,
            description="of a Gaussian across the surface, over its size along it; 1: round",
        )
        footprint: float = Field(
            0.35, ge=0.2, le=1.5, description="Gaussian size before correction [pixels]"
        )
        seed: int = Field(0, ge=0, description="of the initial weights")

    def __init__(self, settings: Settings, backbone: Backbone) -> None:
        super().__init__()
        self.settings, self.patch_size = settings, backbone.patch_size
        if self.patch_size % STRIDE:
            raise SettingsError(
                f"head: edit-fusion needs patches of even size, the backbone has {self.patch_size}."
            )
        given, width = backbone.feature_widths[-1], settings.width
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.project = (
                nn.Identity() if given == width else nn.Conv2d(given, width, 1)
            )
            self.corrections = zero_conv(width, 3 * STRIDE**2)
            self.transport = EditTransport(width)
            self.fusion = EditFusion(width)

    def forward(
        self,
        features: Features,
        images: Float[Tensor, "batch view 3 height width"],
        source: Views | None = None,
        geometry: MatchedGeometry | None = None,
    ) -> Gaussians:
        if source is None or geometry is None:
            raise InputError(
                "edit-fusion needs matched geometry: give the reconstructor a matcher, as edit3r "
                "has."
            )
        grid = tuple(geometry.depths.shape[-2:])
        # An edit is a function of colour pixel by pixel; means of several pixels are not.
        pixels = images, source.images
        picked = [
            F.interpolate(x.flatten(0, 1), grid, mode="nearest-exact").unflatten(
                0, x.shape[:2]
            )
            for x in pixels
        ]
        images, source = (
            Views(images, source.intrinsics).at(grid).images,
            source.at(grid),
        )
        decisions = self._decide(features, images, source, geometry)
        depth, opacity = self.settings.depth_repair, self.settings.opacity_repair
        counted = replace(
            decisions,
            depth_correction=depth * decisions.depth_correction,
            opacity_correction=opacity * decisions.opacity_correction,
            scale_correction=opacity * decisions.scale_correction,
        )
        return assemble(images, source, geometry, counted, self.settings, tuple(picked))

    def _decide(
        self,
        features: Features,
        images: Float[Tensor, "batch view 3 height width"],
        source: Views,
        geometry: MatchedGeometry,
    ) -> Decisions:
        """Everything learned, on the grid of the backbone's images."""
        size = tuple(self.patch_size * side for side in features.grid)
        before, after = resize(source.images, size), resize(images, size)
        tokens = self._tokens(features, size)
        raw = F.pixel_shuffle(self.corrections(tokens.flatten(0, 1)), STRIDE).unflatten(
            0, before.shape[:2]
        )
        depth, opacity, scale = raw.unbind(2)
        depth, scale = 0.7 * torch.tanh(depth), 0.5 * torch.tanh(scale)
        coarse = averaged(geometry, size)
        matches = find_correspondences(
            coarse.depths * depth.detach().exp(), source.intrinsics, geometry.c2w
        )
        looks = looks_of(before, matches, coarse.confidence >= MEASURED)
        shown = shown_by_views(after, before, looks)
        fused = [
            self._fuse(before, after, shown, tokens, matches, view)
            for view in range(1, before.shape[1])
        ]
        carried = zip(*((found.maps, found.choice) for found in fused))
        return Decisions(
            depth,
            opacity,
            scale,
            looks,
            *(torch.stack([torch.zeros_like(x[0]), *x], 1) for x in carried),
        )

    def _tokens(
        self, features: Features, size: tuple[int, int]
    ) -> Float[Tensor, "batch view channel rows columns"]:
        """The last level as maps, one token for STRIDE x STRIDE pixels."""
        maps = features.levels[-1].transpose(-1, -2).unflatten(-1, features.grid)
        flat = self.project(maps.flatten(0, 1))
        if self.patch_size != STRIDE:
            flat = upsample_to(
                flat, flat.new_empty(1, 1, size[0] // STRIDE, size[1] // STRIDE)
            )
        return flat.unflatten(0, maps.shape[:2])

    def _fuse(
        self,
        source: Float[Tensor, "batch view 3 height width"],
        edited: Float[Tensor, "batch view 3 height width"],
        shown: Float[Tensor, "batch view 6 height width"],
        tokens: Float[Tensor, "batch view channel rows columns"],
        matches: Correspondences,
        view: int,
    ) -> FusedEdit:
        """Carry the reference's edit, `shown` as each view would, to one view and weigh it against
        the view's own.
        """
        coordinates = matches.coordinates[:, view]
        before, after = shown[:, view].split(3, 1)
        colours = torch.cat((before, after, after - before), 1)
        carried = self.transport(
            tokens[:, view],
            F.avg_pool2d(tokens[:, 0], KEY_STRIDE // STRIDE),
            F.avg_pool2d(coordinates.permute(0, 3, 1, 2), STRIDE).permute(0, 2, 3, 1),
            fit_colour_maps(before, after, KEY_STRIDE, sigma=0.7),
            F.avg_pool2d(colours, KEY_STRIDE),
        )
        inside = matches.inside[:, view, None]
        warped = warp(colours[:, None, 3:], coordinates[:, None])[:, 0] * inside
        return self.fusion(
            tokens[:, view],
            source[:, view],
            edited[:, view],
            fit_colour_maps(source[:, view], edited[:, view], STRIDE, sigma=1.0),
            carried,
            torch.cat((warped, inside), 1),
        )


def assemble(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Views,
    geometry: MatchedGeometry,
    decisions: Decisions,
    settings: EditFusionHead.Settings,
    picked: tuple[
        Float[Tensor, "batch view 3 height width"],
        Float[Tensor, "batch view 3 height width"],
    ],
) -> Gaussians:
    """Turn geometry, images and decisions into one Gaussian per pixel, in the frame of view 0.

    `picked` are single pixels of the edited and the unedited photos, in which edits are compared.
    """
    images = source.images
    fine = _at_image_size(decisions, images)
    depths = geometry.depths * fine.depth_correction.exp()
    matches = find_correspondences(depths, source.intrinsics, geometry.c2w)
    floating = contradicted(geometry, source.intrinsics)
    logits = (
        math.log(settings.opacity / (1 - settings.opacity)) + fine.opacity_correction
    )
    colours, yielding = edited, 1.0
    if settings.fuse_edits and not torch.equal(edited, images):
        shown = shown_by_views(edited, images, decisions.looks)
        near = near_an_edit(
            edited, images, shown, matches, geometry.confidence >= MEASURED
        )
        near = near * edits_disagree(
            *picked, shown_by_views(*picked, decisions.looks), matches
        )
        colours = fuse_colours(edited, images, shown, fine, matches, near)
        conflict = edits_conflict(edited, images, shown, matches, near)
        yielding = 1 - (1 - settings.conflict_opacity) * conflict
    opacities = torch.sigmoid(logits) * torch.where(
        floating, FLOATING_OPACITY, yielding
    )
    scales = (
        pixel_scales(depths, source.intrinsics, settings.footprint)
        * fine.scale_correction.exp()
    )
    cameras = Cameras(geometry.c2w, source.intrinsics, source.image_size)
    gaussians = pixels_to_gaussians(colours, depths, cameras, scales, opacities)
    return discs(gaussians, tuple(depths.shape[1:]), settings.thickness)


def fuse_colours(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    reference: Float[Tensor, "batch view 6 height width"],
    decisions: Decisions,
    matches: Correspondences,
    near: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 3 height width"]:
    """Mix the candidates for each pixel's colour; exactly `edited` where it is not `near` a
    change.
    """
    shape = source.shape[:2]
    before, after = reference.split(3, 2)
    change = change_of(decisions.maps.flatten(0, 1), source.flatten(0, 1)).unflatten(
        0, shape
    )
    # On colours unlike any that the edit met, an affine map goes on for ever: grey beside a green
    # hole would turn pink.
    made = after - before
    least, most = (
        made.amin((3, 4), keepdim=True).clamp(max=0),
        made.amax((3, 4), keepdim=True).clamp(min=0),
    )
    carried = (source + change.clamp(least, most)).clamp(0, 1)
    warped, change = warp(torch.cat((after, made), 2), matches.coordinates).split(3, 2)
    presence = blur(change.abs().amax(2).flatten(0, 1)[:, None], 1.0).unflatten(
        0, shape
    )
    presence = (presence / VISIBLE_CHANGE).clamp(max=1) * matches.inside[:, :, None]
    choice = decisions.choice * near[:, :, None]
    taken = choice[:, :, 2:] * presence
    # Where the reference shows no edit, the share of its colour goes to the source under the
    # carried colour map.
    mapped = choice[:, :, 1:2] + choice[:, :, 2:] - taken
    return edited + mapped * (carried - edited) + taken * (warped - edited)


def _at_image_size(
    decisions: Decisions, images: Float[Tensor, "batch view 3 height width"]
) -> Decisions:
    """The decisions at the images' size, along the images' edges."""
    single = (
        decisions.depth_correction,
        decisions.opacity_correction,
        decisions.scale_correction,
    )
    stacked = torch.cat((torch.stack(single, 2), decisions.maps, decisions.choice), 2)
    fine = guided_upsample(stacked.flatten(0, 1), images.flatten(0, 1)).unflatten(
        0, images.shape[:2]
    )
    depth, opacity, scale = fine[:, :, :3].unbind(2)
    choice = fine[:, :, -decisions.choice.shape[2] :]
    choice = choice / choice.sum(2, keepdim=True).clamp(min=1e-6)
    return Decisions(depth, opacity, scale, decisions.looks, fine[:, :, 3:-3], choice)
