"""Head `edit-fusion`: the edit carried from the reference to the other views, and one Gaussian per
image pixel.

features --> corrections of depth, opacity and scale
colour maps of images --> EditTransport (reference -> view) --> EditFusion --> choice of colours

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

import edit3r
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Backbone, GaussianHead, Geometry
from edit3r.contract.settings import Index, Share
from edit3r.contract.types import Cameras, Features, Gaussians, Views
from edit3r.kit.compute.layers import bilinear
from edit3r.kit.geometry.cameras import pixel_scales, pixels_to_gaussians
from edit3r.kit.geometry.maps import resize, size_of
from edit3r.kit.geometry.warping import contradicted, warp
from edit3r_model.colour_function import CHANNELS, blur_maps, change_of, fit_colour_maps
from edit3r_model.disagreement import (
    edits_conflict,
    edits_disagree,
    near_an_edit,
    shown_by_reference,
)
from edit3r_model.edit_fusion import CANDIDATES, EditFusion, EditTransport, FusedEdit
from edit3r_model.edited_views import (
    CHANGE,
    EditedViews,
    Exposure,
    Images,
    Maps,
    find_correspondences,
    find_exposure,
)
from edit3r_model.layers import guided_upsample
from edit3r_model.matched_unet import STRIDE, averaged, zero_conv
from edit3r_model.surface import discs

KEY_STRIDE = 4
"""Pixels of the backbone's images per side of what the reference offers to attention."""
VISIBLE_CHANGE = 0.05
"""A change of the reference below this [sRGB] counts in proportion: no edit there, no colour taken
from there. No figure kept.
"""
MEASURED = 0.5
"""Confidence below which a depth was filled in."""
FLOATING_OPACITY = 0.02
"""Share of its opacity that a point keeps which other photos contradict. No figure kept."""
CONFLICT_OPACITY = 0.45
"""Share of its opacity that a view keeps where its edit contradicts the reference's; measured, see
docs/model-card.md.
"""


@dataclass(frozen=True)
class Decisions:
    """Corrections and choices of colour for every view, on the backbone's grid."""

    # of log depth (-0.7, 0.7), opacity logit, log scale (-0.5, 0.5)
    corrections: Images
    choices: "Choices | None"  # of colours; None: every view keeps its own


@dataclass(frozen=True)
class Choices:
    """Where each view's colours come from."""

    exposure: Exposure  # gain and offset from the reference's colours to each view's
    maps: Float[Tensor, "batch view 12 height width"]  # carried; 0 for the reference
    weights: Images  # of the candidates, together 1; 0 for the reference


class EditFusionHead(GaussianHead):
    """Corrects matched geometry, and draws edits that disagree to the reference's; starts as no
    correction.

    It reads the last level of any backbone. The Gaussians lie on the geometry's grid, whatever the
    images' size.
    """

    uses_geometry = True

    class Settings(edit3r.Settings):
        width: int = Field(32, ge=8, le=512, multiple_of=8)
        """channels; features of others are projected"""
        fuse_edits: bool = True
        """false: each view keeps its own edited colours (plain reconstruction)"""
        depth_repair: Share = 0.0
        """share of the network's depth correction that counts; images are better without, training
        sets 1, so that losses on the centres move something
        """
        opacity_repair: Share = 1.0
        """share of its corrections of opacity and size"""
        opacity: float = Field(0.6, gt=0, lt=1)
        """before correction"""
        conflict_opacity: float = Field(CONFLICT_OPACITY, gt=0, le=1)
        """share of its opacity that a view keeps where its edit contradicts the reference's; 1: all
        """
        thickness: float = Field(0.3, gt=0, le=1)
        """of a Gaussian across the surface, over its size along it; 1: round"""
        footprint: float = Field(0.35, ge=0.2, le=1.5)
        """Gaussian size before correction [pixels]"""
        seed: Index = 0
        """of the initial weights"""

    settings: Settings

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
            fits = given == width
            self.project = nn.Identity() if fits else nn.Conv2d(given, width, 1)
            self.corrections = zero_conv(width, 3 * STRIDE**2)
            self.transport = EditTransport(width)
            self.fusion = EditFusion(width)

    def forward(
        self,
        features: Features,
        images: Images,
        source: Views,
        geometry: Geometry | None,
    ) -> Gaussians:
        if geometry is None:
            raise InputError(
                "edit-fusion needs geometry: pass what a matcher read from `source`."
            )
        grid = size_of(geometry.depths)
        changed = replace(source, images=images)
        # An edit is a function of colour pixel by pixel; means of several pixels are not.
        single = _nearest(images, grid), _nearest(source.images, grid)
        edited, source = changed.at(grid).images, source.at(grid)
        fuses = self.settings.fuse_edits and not torch.equal(edited, source.images)
        decisions = self._decide(features, edited, source, geometry, fuses)
        return assemble(edited, source, geometry, decisions, self.settings, single)

    def _decide(
        self,
        features: Features,
        images: Images,
        source: Views,
        geometry: Geometry,
        fuses: bool,
    ) -> Decisions:
        """Everything learned, on the grid of the backbone's images."""
        rows, columns = features.grid
        size = (self.patch_size * rows, self.patch_size * columns)
        before, after = resize(source.images, size), resize(images, size)
        tokens = self._tokens(features, size)
        raw = F.pixel_shuffle(self.corrections(tokens.flatten(0, 1)), STRIDE)
        depth, opacity, scale = raw.unflatten(0, before.shape[:2]).unbind(2)
        depth, scale = 0.7 * torch.tanh(depth), 0.5 * torch.tanh(scale)
        choices = None
        if fuses:
            coarse = averaged(geometry, size)
            coarse = replace(coarse, depths=coarse.depths * depth.detach().exp())
            choices = self._choose(tokens, after, before, source.intrinsics, coarse)
        return Decisions(torch.stack((depth, opacity, scale), 2), choices)

    def _choose(
        self,
        tokens: Float[Tensor, "batch view channel rows columns"],
        after: Images,
        before: Images,
        intrinsics: Float[Tensor, "batch view 3 3"],
        geometry: Geometry,
    ) -> Choices:
        """What each view takes of the reference's edit."""
        matches = find_correspondences(geometry.depths, intrinsics, geometry.c2w)
        exposure = find_exposure(before, matches, geometry.confidence >= MEASURED)
        views = EditedViews.of(after, before, exposure, matches)
        size = before.shape[-2:]
        counts = CHANNELS, CANDIDATES
        zeros = (before.new_zeros(len(before), count, *size) for count in counts)
        none = FusedEdit(*zeros)
        others = range(1, before.shape[1])
        fused = [none, *(self._fuse(views, tokens, view) for view in others)]
        return Choices(
            exposure=exposure,
            maps=torch.stack([edit.maps for edit in fused], 1),
            weights=torch.stack([edit.choice for edit in fused], 1),
        )

    def _tokens(
        self, features: Features, size: tuple[int, int]
    ) -> Float[Tensor, "batch view channel rows columns"]:
        """The last level as maps, one token for STRIDE x STRIDE pixels."""
        maps = features.levels[-1].transpose(-1, -2).unflatten(-1, features.grid)
        flat = self.project(maps.flatten(0, 1))
        if self.patch_size != STRIDE:
            flat = bilinear(flat, (size[0] // STRIDE, size[1] // STRIDE))
        return flat.unflatten(0, maps.shape[:2])

    def _fuse(
        self,
        views: EditedViews,
        tokens: Float[Tensor, "batch view channel rows columns"],
        view: int,
    ) -> FusedEdit:
        """Carry the reference's edit to one view, as it would show it, and weigh both."""
        coordinates = views.matches.coordinates[:, view]
        before, after = views.before[:, view], views.after[:, view]
        colours = torch.cat((before, after, after - before), 1)
        places = F.avg_pool2d(coordinates.permute(0, 3, 1, 2), STRIDE)
        carried = self.transport(
            tokens[:, view],
            reference=F.avg_pool2d(tokens[:, 0], KEY_STRIDE // STRIDE),
            coordinates=places.permute(0, 2, 3, 1),
            maps=fit_colour_maps(before, after, KEY_STRIDE, sigma=0.7),
            colours=F.avg_pool2d(colours, KEY_STRIDE),
        )
        source, edited = views.source[:, view], views.edited[:, view]
        inside = views.matches.inside[:, view, None]
        warped = warp(colours[:, 3:], coordinates) * inside
        return self.fusion(
            tokens[:, view],
            source,
            edited,
            own_maps=fit_colour_maps(source, edited, STRIDE, sigma=1.0),
            carried=carried,
            warped=torch.cat((warped, inside), 1),
        )


def _nearest(images: Images, size: tuple[int, int]) -> Images:
    """Single pixels of the images, at `size`."""
    picked = F.interpolate(images.flatten(0, 1), size, mode="nearest-exact")
    return picked.unflatten(0, images.shape[:2])


def assemble(
    edited: Images,
    source: Views,
    geometry: Geometry,
    decisions: Decisions,
    settings: EditFusionHead.Settings,
    single: tuple[Images, Images],
) -> Gaussians:
    """Turn geometry, images and decisions into one Gaussian per pixel, in the frame of view 0.

    `single` are single pixels of the edited and the unedited photos, in which edits are compared.
    """
    fine = _at_image_size(decisions, source.images)
    depth, opacity, scale = fine.corrections.unbind(2)
    depths = geometry.depths * (settings.depth_repair * depth).exp()
    usual = math.log(settings.opacity / (1 - settings.opacity))
    opacity = torch.sigmoid(usual + settings.opacity_repair * opacity)
    scales = pixel_scales(depths, source.intrinsics, settings.footprint)
    scales = scales * (settings.opacity_repair * scale).exp()

    colours = edited
    kept: float | Tensor = 1.0
    choices = fine.choices
    if choices is not None:
        matches = find_correspondences(depths, source.intrinsics, geometry.c2w)
        views = EditedViews.of(edited, source.images, choices.exposure, matches)
        disagree = edits_disagree(EditedViews.of(*single, choices.exposure, matches))
        measured = geometry.confidence >= MEASURED
        near = near_an_edit(views, measured) * disagree
        seen = shown_by_reference(views, measured)
        colours = fuse_colours(views, choices, near, seen)
        conflict = edits_conflict(views, near)
        kept = 1 - (1 - settings.conflict_opacity) * conflict
    floating = contradicted(geometry, source.intrinsics)
    opacity = opacity * torch.where(floating, FLOATING_OPACITY, kept)

    cameras = Cameras(geometry.c2w, source.intrinsics, source.image_size)
    gaussians = pixels_to_gaussians(colours, depths, cameras, scales, opacity)
    return discs(gaussians, (depths.shape[1], *size_of(depths)), settings.thickness)


def fuse_colours(
    views: EditedViews, choices: Choices, near: Maps, seen: Maps
) -> Images:
    """Mix the candidates for each pixel's colour; exactly the view's own where it is not `near` a
    change.

    The candidates are its own edited colour, the source under the carried colour map, and the
    reference's edited colour. Where the reference does not show the place (`seen` 0), a map that
    changes less than the view's own edit counts that much less: nothing carried contradicts
    nothing.
    """
    made = views.after - views.before
    # On colours unlike any that the edit met, an affine map goes on for ever: grey beside a green
    # hole would turn pink.
    least = made.amin((3, 4), keepdim=True).clamp(max=0)
    most = made.amax((3, 4), keepdim=True).clamp(min=0)
    change = change_of(choices.maps, views.source).clamp(least, most)
    carried = _no_stronger(change, views)
    _, warped = views.reference
    shown = warp(made, views.matches.coordinates).abs().amax(2)
    presence = (blur_maps(shown, 1.0) / VISIBLE_CHANGE).clamp(max=1)
    presence = (presence * views.matches.inside)[:, :, None]
    _, mapped, taken = (choices.weights * near[:, :, None]).split(1, 2)
    # Where the reference shows no edit, the share of its colour goes to the source under the
    # carried colour map.
    shares = mapped + taken - taken * presence, taken * presence
    sizes = [made.abs().amax(2, keepdim=True) for made in (change, views.change)]
    strength = (sizes[0] / sizes[1].clamp(min=1e-6)).clamp(max=1)
    told = torch.maximum(strength, seen[:, :, None])
    shares = shares[0] * told, shares[1]
    own = views.edited
    return own + shares[0] * (carried - own) + shares[1] * (warped - own)


def _no_stronger(change: Images, views: EditedViews) -> Images:
    """The source's colours after the change, as near to grey as the strongest that the reference's
    edit made, and no nearer than a change of that size brings them: what it never met (grass, for a
    pencil drawing) becomes no greener than the drawing.
    """
    colours = (views.source + change).clamp(0, 1)
    made = (views.after - views.before).abs().amax(2, keepdim=True) > CHANGE
    strongest = (_off_grey(views.after) * made).amax((3, 4), keepdim=True)
    left = _off_grey(views.source) - change.abs().amax(2, keepdim=True)
    share = (strongest + left.clamp(min=0)) / _off_grey(colours).clamp(min=1e-6)
    grey = colours.mean(2, keepdim=True)
    return torch.where(share < 1, grey + (colours - grey) * share, colours)


def _off_grey(colours: Images) -> Float[Tensor, "batch view 1 height width"]:
    return (colours - colours.mean(2, keepdim=True)).abs().amax(2, keepdim=True)


def _at_image_size(decisions: Decisions, images: Images) -> Decisions:
    """The decisions at the images' size, along the images' edges."""

    def finer(maps: Images) -> Images:
        fine = guided_upsample(maps.flatten(0, 1), images.flatten(0, 1))
        return fine.unflatten(0, images.shape[:2])

    # Each on its own: how a number is rounded depends on what lies beside it.
    corrections, choices = finer(decisions.corrections), decisions.choices
    if choices is None:
        return Decisions(corrections, None)
    stacked = finer(torch.cat((choices.maps, choices.weights), 2))
    carried, weights = stacked.split((CHANNELS, CANDIDATES), 2)
    weights = weights / weights.sum(2, keepdim=True).clamp(min=1e-6)
    return Decisions(corrections, Choices(choices.exposure, carried, weights))
