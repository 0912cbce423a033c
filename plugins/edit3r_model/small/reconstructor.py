"""Reconstructor `edit3r`: geometry from matching the unedited photos, the edit from a small trained network."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import torch
from pydantic import Field, model_validator
from torch import Tensor, nn

from edit3r import config, reporting
from edit3r.config import PartChoice
from edit3r.geometry.alignment import scale_poses
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.surroundings import apron, backdrop
from edit3r.geometry.upsampling import resize
from edit3r.interfaces import MatchedGeometry, Matcher, Reconstructor
from edit3r.types import Gaussians, Reconstruction, Views
from edit3r_model.small.assembly import AssemblySettings, assemble
from edit3r_model.small.network import NetworkInputs, NetworkOutputs, network_grid
from edit3r_model.small.weights import load_network


class Edit3rReconstructor(Reconstructor):
    """Matched pose and depth, repaired; every photo pixel a Gaussian; disagreeing edits drawn to the reference's.

    View 0 is the reference: its edit is kept as it is. Without any edit the colours are the photos' own, exactly.
    """

    class Settings(config.Settings):
        matcher: PartChoice = Field(
            PartChoice(
                name="classical", settings={"working_size": 160, "detection_size": 448, "keypoints": 2500, "planes": 64}
            ),
            description="reads pose and depth from the photos; coarser than on its own, for the network repairs it",
        )
        geometry: Literal["matching", "network"] = Field(
            "matching", description="where pose and depth come from; 'network' is short for matcher=network"
        )
        weights: str = Field("shipped", description="'shipped', 'untrained' or a file of `edit3r train`")
        network_size: int = Field(96, ge=32, le=256, multiple_of=8, description="longer side of its grid [pixels]")
        fuse_edits: bool = Field(
            True, description="false: each view keeps its own edited colours (plain reconstruction)"
        )
        depth_repair: float = Field(0.5, ge=0, le=1, description="share of the network's depth correction that counts")
        opacity_repair: float = Field(0.5, ge=0, le=1, description="share of its corrections of opacity and size")
        opacity: float = Field(0.6, gt=0, lt=1, description="before correction, where two views measured the depth")
        filled_opacity: float = Field(0.45, gt=0, lt=1, description="before correction, where the depth was filled in")
        lone_opacity: float = Field(
            0.8, gt=0, lt=1, description="before correction, where it was filled in and no other photo shows the place"
        )
        apron: float = Field(
            0.12, ge=0, le=1, description="width of the blurred rim that continues each photo [long sides]; 0: none"
        )
        backdrop: float = Field(
            0.9, ge=0, le=1, description="opacity of the blurred layer behind depth edges and guesses; 0: none"
        )
        footprint: float = Field(0.35, ge=0.2, le=1.5, description="Gaussian size before correction [pixels]")

        @model_validator(mode="before")
        @classmethod
        def _matcher_by_geometry(cls, values: Any) -> Any:
            if not isinstance(values, Mapping) or values.get("geometry") != "network":
                return values
            matcher = PartChoice.model_validate(values.get("matcher", "network"))
            if matcher.name != "network":
                raise ValueError(f"geometry=network asks for matcher=network, but matcher is {matcher.name!r}")
            return {**values, "matcher": matcher}

    def __init__(self, settings: Settings, matcher: Matcher) -> None:
        self.settings = settings
        self.matcher = matcher
        self._network = load_network(settings.weights)

    @property
    def network(self) -> nn.Module:
        return self._network

    def __call__(self, views: Views, source: Views | None = None) -> Reconstruction:
        """Reconstruct; without `source` the edited pictures must agree well enough to be matched themselves.

        Differentiable only while the network is in training mode.
        """
        reporting.note("edit3r.geometry", "network" if self.settings.matcher.name == "network" else "matching")
        source = views if source is None else source
        with torch.no_grad():
            geometry = self.matcher.match(source)
        views, source = geometry.calibrated(views), geometry.calibrated(source)
        with torch.set_grad_enabled(self._network.training and torch.is_grad_enabled()):
            reconstruction = self.from_geometry(views, source, geometry)
            return self._with_surroundings(reconstruction, source, geometry)

    def from_geometry(self, views: Views, source: Views, geometry: MatchedGeometry) -> Reconstruction:
        """The differentiable part: Gaussians from given geometry; the trainer calls it with geometry of its own."""
        unit = geometry.depths[:, 0].flatten(1).median(1).values
        unit_geometry = _rescaled(geometry, 1 / unit)
        outputs = self._network(self._network_inputs(views, source, unit_geometry))
        outputs = _with_share(outputs, self.settings.depth_repair, self.settings.opacity_repair)
        settings = AssemblySettings(
            self.settings.footprint,
            self.settings.opacity,
            self.settings.filled_opacity,
            self.settings.lone_opacity,
            fuse_edits=self.settings.fuse_edits,
        )
        reconstruction = assemble(views, source, unit_geometry, outputs, settings)
        return _keep_registered(_in_unit(reconstruction, unit), geometry)

    def _network_inputs(self, views: Views, source: Views, geometry: MatchedGeometry) -> NetworkInputs:
        """Everything on the network's grid; depth is averaged as inverse depth."""
        size = network_grid(source.image_size, self.settings.network_size)
        return NetworkInputs(
            photos=resize(source.images, size),
            edited=resize(views.images, size),
            depths=1 / resize(1 / geometry.depths[:, :, None], size)[:, :, 0],
            confidence=resize(geometry.confidence[:, :, None], size)[:, :, 0],
            c2w=geometry.c2w,
            intrinsics=source.intrinsics,
        )

    def _with_surroundings(
        self, reconstruction: Reconstruction, source: Views, geometry: MatchedGeometry
    ) -> Reconstruction:
        """Continue the fused pictures a little beyond their borders and behind their depth edges."""
        shape = (*source.images.shape[:2], *source.image_size, 3)
        colours = dc_to_colour(reconstruction.gaussians.harmonics[:, :, 0]).reshape(shape).permute(0, 1, 4, 2, 3)
        fused = Views(colours, source.intrinsics)
        parts = [reconstruction.gaussians]
        if self.settings.backdrop > 0:
            parts.append(backdrop(fused, geometry, self.settings.backdrop))
        if self.settings.apron > 0:
            parts.append(apron(fused, geometry, self.settings.apron, self.settings.filled_opacity))
        return replace(reconstruction, gaussians=Gaussians.cat(parts))


def _rescaled(geometry: MatchedGeometry, factor: Tensor) -> MatchedGeometry:
    c2w = scale_poses(geometry.c2w, factor[:, None])
    return replace(geometry, c2w=c2w, depths=geometry.depths * factor[:, None, None, None])


def _in_unit(reconstruction: Reconstruction, unit: Tensor) -> Reconstruction:
    """Back to the matcher's unit of length."""
    gaussians, cameras = reconstruction.gaussians, reconstruction.cameras
    scale = unit[:, None, None]
    moved = replace(gaussians, means=gaussians.means * scale, scales=gaussians.scales * scale)
    return Reconstruction(moved, replace(cameras, c2w=scale_poses(cameras.c2w, unit[:, None])))


def _keep_registered(reconstruction: Reconstruction, geometry: MatchedGeometry) -> Reconstruction:
    """Views that could not be placed show nothing: their Gaussians become transparent."""
    if bool(geometry.registered.all()):
        return reconstruction
    gaussians = reconstruction.gaussians
    shown = geometry.registered[:, gaussians.view_index].to(gaussians.opacities.dtype)
    return replace(reconstruction, gaussians=replace(gaussians, opacities=gaussians.opacities * shown))


def _with_share(outputs: NetworkOutputs, depth: float, opacity: float) -> NetworkOutputs:
    """The network's corrections of geometry, each taken in part."""
    return replace(
        outputs,
        depth_correction=depth * outputs.depth_correction,
        opacity_correction=opacity * outputs.opacity_correction,
        scale_correction=opacity * outputs.scale_correction,
        disagreement=opacity * outputs.disagreement,
    )
