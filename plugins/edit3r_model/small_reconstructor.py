"""Reconstructor `edit3r`: geometry from matching the unedited images, the edit from a small trained network.

Every image pixel becomes one Gaussian, at the image's own resolution and sharpness.
"""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from edit3r import config, reporting
from edit3r.config import PartChoice
from edit3r.errors import SettingsError
from edit3r.geometry.cameras import pixel_scales, pixels_to_gaussians, scale_poses
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.maps import guided_upsample, resize
from edit3r.geometry.surroundings import apron, backdrop
from edit3r.geometry.warping import Correspondences, contradicted, find_correspondences, warp
from edit3r.interfaces import MatchedGeometry, Matcher, Reconstructor
from edit3r.registry import build
from edit3r.types import Cameras, EditRequest, Gaussians, Reconstruction, Views
from edit3r_model.edit_colour import blur, change_of, edits_conflict, edits_disagree, near_an_edit
from edit3r_model.small_network import NetworkInputs, NetworkOutputs, load_network, network_grid
from edit3r_model.surface import discs

VISIBLE_CHANGE = 0.05
"""A change of the reference below this [sRGB] counts in proportion: no edit there, no colour taken from there."""
MEASURED = 0.5
"""Confidence below which a depth was filled in."""
FLOATING_OPACITY = 0.02
"""Before correction, of points that other photos contradict."""


class Edit3rReconstructor(Reconstructor):
    """Matched poses and depths, and a network that draws disagreeing edits to the reference's.

    View 0 is the reference: its edit is kept as it is. Where another view's edit is the same function of colour, that
    view keeps its own edited colours exactly, as it does without any edit.
    """

    takes_geometry = True

    class Settings(config.Settings):
        matcher: PartChoice = Field(
            PartChoice(
                name="classical", settings={"working_size": 160, "detection_size": 448, "keypoints": 2500, "planes": 64}
            ),
            description="reads pose and depth from the photos; coarser and quicker than on its own",
        )
        weights: str = Field(
            "shipped",
            description="'shipped', 'untrained', a file or the folder best of `edit3r train`; 'official' or other "
            "weights of the full network take its place: geometry and edit from that network alone",
        )
        full: dict[str, Any] = Field(
            default_factory=dict, description="settings of `noposplat` that count with weights of the full network"
        )
        network_size: int = Field(96, ge=32, le=256, multiple_of=8, description="longer side of its grid [pixels]")
        fuse_edits: bool = Field(
            True, description="false: each view keeps its own edited colours (plain reconstruction)"
        )
        depth_repair: float = Field(
            0.0,
            ge=0,
            le=1,
            description="share of the network's depth correction that counts; pictures are better without, training "
            "sets 1, so that losses on the centres move something",
        )
        opacity_repair: float = Field(0.5, ge=0, le=1, description="share of its corrections of opacity and size")
        opacity: float = Field(0.6, gt=0, lt=1, description="before correction")
        conflict_opacity: float = Field(
            0.45,
            gt=0,
            le=1,
            description="share of its opacity that a view keeps where its edit contradicts the reference's; 1: all",
        )
        apron: float = Field(
            0.12, ge=0, le=1, description="width of the blurred rim that continues each photo [long sides]; 0: none"
        )
        backdrop: float = Field(
            0.9, ge=0, le=1, description="opacity of the blurred layer behind depth edges and guesses; 0: none"
        )
        thickness: float = Field(
            0.3, gt=0, le=1, description="of a Gaussian across the surface, over its size along it; 1: round"
        )
        footprint: float = Field(0.35, ge=0.2, le=1.5, description="Gaussian size before correction [pixels]")

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings = settings
        self.matcher = matcher
        self.full = _full_form(settings)  # None: the small form
        self.takes_geometry = self.full is None
        self._network = load_network(settings.weights) if self.full is None else self.full.network

    @property
    def network(self) -> nn.Module:
        """The trainable part."""
        return self._network

    def __call__(self, views: Views, source: Views | None = None, request: EditRequest | None = None) -> Reconstruction:
        """Reconstruct; without `source` the edited images must agree well enough to be matched themselves.

        Of `request` the `grid` counts. Differentiable only while the network is in training mode.
        """
        if self.full is not None:
            reporting.note("edit3r.form", "full")
            return self.full(views)
        source = views if source is None else source
        with torch.no_grad():
            geometry = self.matcher.match(source)
        grid = views.image_size if request is None else request.grid_of(views.image_size)
        views, source = (geometry.calibrated(shown).at(grid) for shown in (views, source))
        measured, geometry = geometry.measured, geometry.at(grid)
        with torch.set_grad_enabled(self._network.training and torch.is_grad_enabled()):
            reconstruction = self.from_geometry(views, source, geometry)
            reconstruction = self._with_surroundings(reconstruction, source, geometry)
        return replace(reconstruction, placed=geometry.registered, measured=measured)

    def from_geometry(self, views: Views, source: Views, geometry: MatchedGeometry) -> Reconstruction:
        """Reconstruct from given geometry, differentiably; the trainer calls this with geometry of its own."""
        unit = geometry.depths[:, 0].flatten(1).median(1).values
        unit_geometry = _in_unit(geometry, unit)
        outputs = self._network(self._network_inputs(views, source, unit_geometry))
        reconstruction = assemble(views, source, unit_geometry, self._with_share(outputs), self.settings)
        return _hide_unplaced(_back_from_unit(reconstruction, unit), geometry)

    def _network_inputs(self, views: Views, source: Views, geometry: MatchedGeometry) -> NetworkInputs:
        """Everything on the network's grid; depths are averaged as inverse depths."""
        size = network_grid(source.image_size, self.settings.network_size)
        return NetworkInputs(
            source=resize(source.images, size),
            edited=resize(views.images, size),
            depths=1 / resize(1 / geometry.depths[:, :, None], size)[:, :, 0],
            confidence=resize(geometry.confidence[:, :, None], size)[:, :, 0],
            c2w=geometry.c2w,
            intrinsics=source.intrinsics,
        )

    def _with_share(self, outputs: NetworkOutputs) -> NetworkOutputs:
        """The share of the network's corrections of geometry that the settings let count."""
        depth, opacity = self.settings.depth_repair, self.settings.opacity_repair
        return replace(
            outputs,
            depth_correction=depth * outputs.depth_correction,
            opacity_correction=opacity * outputs.opacity_correction,
            scale_correction=opacity * outputs.scale_correction,
            disagreement=opacity * outputs.disagreement,
        )

    def _with_surroundings(
        self, reconstruction: Reconstruction, source: Views, geometry: MatchedGeometry
    ) -> Reconstruction:
        """Continue the fused images a little beyond their borders and behind their depth edges."""
        shape = (*source.images.shape[:2], *source.image_size, 3)
        colours = dc_to_colour(reconstruction.gaussians.harmonics[:, :, 0]).reshape(shape).permute(0, 1, 4, 2, 3)
        fused = Views(colours, source.intrinsics)
        parts = [reconstruction.gaussians]
        if self.settings.backdrop > 0:
            parts.append(backdrop(fused, geometry, self.settings.backdrop))
        if self.settings.apron > 0:
            parts.append(apron(fused, geometry, self.settings.apron, self.settings.opacity))
        return replace(reconstruction, gaussians=Gaussians.cat(parts))


def _full_form(settings: Edit3rReconstructor.Settings) -> Reconstructor | None:
    """The paper's own network where the weights are its weights, else None; raises SettingsError for misfits."""
    if settings.weights not in ("shipped", "untrained"):  # the small form loads nothing of the full one
        from edit3r_model.checkpoints import are_of_the_full_network

        if are_of_the_full_network(settings.weights):
            return build("reconstructor", "noposplat", **{**settings.full, "weights": settings.weights})
    if settings.full:
        raise SettingsError("reconstructor.full: counts with weights of the full network only, such as official.")
    return None


def assemble(
    edited: Views,
    source: Views,
    geometry: MatchedGeometry,
    outputs: NetworkOutputs,
    settings: Edit3rReconstructor.Settings,
) -> Reconstruction:
    """Turn geometry, images and the network's decisions into one Gaussian per pixel, in the frame of view 0."""
    images = source.images
    fine = _at_image_size(outputs, images)
    depths = geometry.depths * fine.depth_correction.exp()
    matches = find_correspondences(depths, source.intrinsics, geometry.c2w)
    floating = contradicted(geometry, source.intrinsics)
    logits = torch.logit(torch.where(floating, FLOATING_OPACITY, settings.opacity)) + fine.opacity_correction
    colours, yielding = edited.images, 1.0
    if settings.fuse_edits:
        near = near_an_edit(edited.images, images, matches, geometry.confidence >= MEASURED)
        near = near * edits_disagree(edited.images, images, matches)
        colours = fuse_colours(edited.images, images, fine, matches, near)
        logits = logits + near * fine.disagreement
        conflict = edits_conflict(edited.images, images, matches, near)
        yielding = 1 - (1 - settings.conflict_opacity) * conflict
    opacities = torch.sigmoid(logits) * yielding
    scales = pixel_scales(depths, source.intrinsics, settings.footprint) * fine.scale_correction.exp()
    cameras = Cameras(geometry.c2w, source.intrinsics, source.image_size)
    gaussians = pixels_to_gaussians(colours, depths, cameras, scales, opacities)
    return Reconstruction(discs(gaussians, tuple(depths.shape[1:]), settings.thickness), cameras)


def fuse_colours(
    edited: Float[Tensor, "batch view 3 height width"],
    source: Float[Tensor, "batch view 3 height width"],
    outputs: NetworkOutputs,
    matches: Correspondences,
    near: Float[Tensor, "batch view height width"],
) -> Float[Tensor, "batch view 3 height width"]:
    """Mix the candidates for each pixel's colour; exactly `edited` where it is not `near` a change."""
    shape = source.shape[:2]
    carried = (source + change_of(outputs.maps.flatten(0, 1), source.flatten(0, 1)).unflatten(0, shape)).clamp(0, 1)
    reference = torch.cat((edited[:, :1], (edited - source)[:, :1]), 2).expand(-1, shape[1], -1, -1, -1)
    warped, change = warp(reference, matches.coordinates).split(3, 2)
    presence = blur(change.abs().amax(2).flatten(0, 1)[:, None], 1.0).unflatten(0, shape)
    presence = (presence / VISIBLE_CHANGE).clamp(max=1) * matches.inside[:, :, None]
    choice = outputs.choice * near[:, :, None]
    taken = choice[:, :, 2:] * presence
    # Where the reference shows no edit, the share of its colour goes to the source under the carried colour map.
    mapped = choice[:, :, 1:2] + choice[:, :, 2:] - taken
    return edited + mapped * (carried - edited) + taken * (warped - edited)


def _at_image_size(outputs: NetworkOutputs, images: Float[Tensor, "batch view 3 height width"]) -> NetworkOutputs:
    """The network's maps at the images' size, along the images' edges."""
    single = (outputs.depth_correction, outputs.opacity_correction, outputs.scale_correction, outputs.disagreement)
    stacked = torch.cat((torch.stack(single, 2), outputs.maps, outputs.choice), 2)
    fine = guided_upsample(stacked.flatten(0, 1), images.flatten(0, 1)).unflatten(0, images.shape[:2])
    depth, opacity, scale, disagreement = fine[:, :, :4].unbind(2)
    choice = fine[:, :, -outputs.choice.shape[2] :]
    choice = choice / choice.sum(2, keepdim=True).clamp(min=1e-6)
    return NetworkOutputs(depth, opacity, scale, disagreement, fine[:, :, 4:-3], choice)


def _in_unit(geometry: MatchedGeometry, unit: Float[Tensor, "batch"]) -> MatchedGeometry:
    """The geometry with `unit` as its unit of length."""
    factor = 1 / unit
    return replace(
        geometry, c2w=scale_poses(geometry.c2w, factor[:, None]), depths=geometry.depths * factor[:, None, None, None]
    )


def _back_from_unit(reconstruction: Reconstruction, unit: Float[Tensor, "batch"]) -> Reconstruction:
    """The reconstruction in the matcher's own unit of length."""
    gaussians, cameras, factor = reconstruction.gaussians, reconstruction.cameras, unit[:, None, None]
    moved = replace(gaussians, means=gaussians.means * factor, scales=gaussians.scales * factor)
    return Reconstruction(moved, replace(cameras, c2w=scale_poses(cameras.c2w, unit[:, None])))


def _hide_unplaced(reconstruction: Reconstruction, geometry: MatchedGeometry) -> Reconstruction:
    """Make the Gaussians of views that could not be placed transparent."""
    if bool(geometry.registered.all()):
        return reconstruction
    gaussians = reconstruction.gaussians
    shown = geometry.registered[:, gaussians.view_index].to(gaussians.opacities.dtype)
    return replace(reconstruction, gaussians=replace(gaussians, opacities=gaussians.opacities * shown))
