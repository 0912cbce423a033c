"""Reconstructor `edit3r`: geometry from matching the unedited images, the edit from a small trained
network.

Every image pixel becomes one Gaussian, at the image's own resolution and sharpness.
"""

import hashlib
import json
from dataclasses import replace
from math import lcm
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from pydantic import Field
from torch import Tensor, nn

from edit3r import config, reporting
from edit3r.compute.layers import one_thread
from edit3r.config import PartChoice
from edit3r.contract.interfaces import (
    Backbone,
    GaussianHead,
    GeometryBackbone,
    GeometryHead,
    MatchedGeometry,
    Matcher,
    Reconstructor,
    TakesGeometry,
)
from edit3r.contract.types import Cameras, Gaussians, Reconstruction, Views
from edit3r.errors import SettingsError
from edit3r.geometry.cameras import scale_poses
from edit3r.geometry.harmonics import dc_to_colour
from edit3r.geometry.maps import resize
from edit3r.geometry.surroundings import apron, backdrop, lining
from edit3r.io.weight_files import WEIGHTS, load_weights
from edit3r.plugins.registry import build
from edit3r_model.small_backbone import averaged

SHIPPED = Path(__file__).parent / "weights" / "edit3r-small.safetensors"
ROUNDING = 1e-5
"""Differences of colour [sRGB] that come from turning colours into harmonics and back."""
GRID = 8
"""The network's images have sides that are multiples of this [pixels]."""


class Edit3rReconstructor(Reconstructor, TakesGeometry):
    """Matched poses and depths, and a network that draws disagreeing edits to the reference's.

    View 0 is the reference: its edit is kept as it is. Where another view's edit is the same
    function of colour, that view keeps its own edited colours exactly, as it does without any edit.

    It is made of its parts: the matcher reads geometry from the unedited images, the backbone turns
    both into features, the head makes the Gaussians. Parts that take no geometry are the paper's
    form: no matcher then.
    """

    class Settings(config.Settings):
        matcher: PartChoice = Field(
            PartChoice(
                name="classical",
                settings={
                    "working_size": 160,
                    "detection_size": 448,
                    "keypoints": 2500,
                    "planes": 64,
                },
            ),
            description="reads pose and depth from the photos; coarser and quicker than on its own",
        )
        backbone: PartChoice = Field(
            PartChoice(name="matched-unet"),
            description="images and geometry to features",
        )
        head: PartChoice = Field(
            PartChoice(name="edit-fusion"), description="features to Gaussians"
        )
        weights: str = Field(
            "shipped",
            description="'shipped', 'untrained', a file or the folder best of `edit3r train`; "
            "'official' or other "
            "weights of the full network take the parts' place: geometry and edit from that "
            "network alone",
        )
        full: dict[str, Any] = Field(
            default_factory=dict,
            description="settings of `noposplat` that count with weights of the full network",
        )
        network_size: int = Field(
            128,
            ge=32,
            le=256,
            multiple_of=8,
            description="longer side of its grid [pixels]",
        )
        apron: float = Field(
            0.12,
            ge=0,
            le=1,
            description="width of the blurred rim that continues each photo [long sides]; 0: none",
        )
        apron_opacity: float = Field(0.6, gt=0, lt=1, description="opacity of that rim")
        backdrop: float = Field(
            0.9,
            ge=0,
            le=1,
            description="opacity of the blurred layer behind depth edges and guesses; 0: none",
        )
        lining: float = Field(
            0.9,
            ge=0,
            le=1,
            description="opacity of the second layer right behind faint measured surfaces; 0: none",
        )

    def __init__(
        self,
        settings: Settings,
        matcher: Matcher,
        backbone: Backbone,
        head: GaussianHead,
    ) -> None:
        self.settings = settings
        self.matcher, self.backbone, self.head = matcher, backbone, head
        self.full = _full_form(settings, backbone, head)  # None: the small form
        self._network = (
            self.full.network
            if self.full
            else load_parts(settings.weights, backbone, head)
        )

    @property
    def network(self) -> nn.Module:
        """The trainable part: backbone and head together."""
        return self._network

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        """Reconstruct; without `source` the edited images must agree well enough to be matched
        themselves.

        Differentiable only while the network is in training mode.
        """
        if self.full is not None:
            reporting.note("edit3r.form", "full")
            return self.full(views)
        source = views if source is None else source
        with torch.no_grad():
            geometry = self.matcher.match(source)
        grid = grid or views.image_size
        views, source = (geometry.calibrated(shown) for shown in (views, source))
        measured, geometry = geometry.measured, geometry.at(grid)
        # Silu, sigmoid and others round the last few values of what each thread is given in another
        # way.
        with (
            one_thread(),
            torch.set_grad_enabled(self._network.training and torch.is_grad_enabled()),
        ):
            reconstruction = self.from_geometry(views, source, geometry)
            reconstruction = self._with_surroundings(
                reconstruction, views.at(grid), source.at(grid), geometry
            )
        return replace(reconstruction, placed=geometry.registered, measured=measured)

    def from_geometry(
        self, views: Views, source: Views, geometry: MatchedGeometry
    ) -> Reconstruction:
        """Reconstruct from given geometry, differentiably; the trainer calls this with geometry of
        its own.

        The Gaussians lie on the geometry's grid; the views may be finer.
        """
        unit = geometry.depths[:, 0].flatten(1).median(1).values
        prior = _in_unit(geometry, unit)
        cameras = Cameras(prior.c2w, source.intrinsics, tuple(prior.depths.shape[-2:]))
        reconstruction = Reconstruction(self._gaussians(views, source, prior), cameras)
        return _hide_unplaced(_back_from_unit(reconstruction, unit), geometry)

    def _gaussians(
        self, views: Views, source: Views, prior: MatchedGeometry
    ) -> Gaussians:
        """Backbone, then head; only parts that take geometry are given it."""
        photos = views.images, source
        views, source = (
            shown.at(tuple(prior.depths.shape[-2:])) for shown in (views, source)
        )
        size = network_grid(
            source.image_size, self.settings.network_size, self.backbone.patch_size
        )
        looks = isinstance(self.backbone, GeometryBackbone)
        given = (averaged(prior, size),) if looks else ()
        features = self.backbone(resize(source.images, size), source.intrinsics, *given)
        if isinstance(self.head, GeometryHead):
            return self.head(features, *photos, prior)
        from edit3r_model import view_fitting

        gaussians = self.head(features, view_fitting.resize(views.images, size))
        return view_fitting.regrid(gaussians, size, views.image_size, views.images)

    def _with_surroundings(
        self,
        reconstruction: Reconstruction,
        views: Views,
        source: Views,
        geometry: MatchedGeometry,
    ) -> Reconstruction:
        """Continue the fused images a little beyond their borders and behind their depth edges; and
        say what fused.
        """
        shape = (*source.images.shape[:2], *source.image_size, 3)
        colours = (
            dc_to_colour(reconstruction.gaussians.harmonics[:, :, 0])
            .reshape(shape)
            .permute(0, 1, 4, 2, 3)
        )
        fused = Views(colours, source.intrinsics)
        parts = [reconstruction.gaussians]
        if self.settings.backdrop > 0:
            parts.append(backdrop(fused, geometry, self.settings.backdrop))
        if self.settings.lining > 0:
            opacities = reconstruction.gaussians.opacities.view_as(geometry.depths)
            parts.append(lining(fused, geometry, opacities, self.settings.lining))
        if self.settings.apron > 0:
            parts.append(
                apron(fused, geometry, self.settings.apron, self.settings.apron_opacity)
            )
        fusion = (colours - views.images).detach()
        fusion = torch.where(fusion.abs() > ROUNDING, fusion, 0.0)
        return replace(
            reconstruction,
            gaussians=Gaussians.cat(parts),
            fusion=fusion if fusion.any() else None,
        )


def _full_form(
    settings: Edit3rReconstructor.Settings, backbone: Backbone, head: GaussianHead
) -> Reconstructor | None:
    """The paper's form where parts or weights ask for it, else None; raises SettingsError for
    misfits.
    """
    if not (isinstance(backbone, GeometryBackbone) or isinstance(head, GeometryHead)):
        if settings.weights == "shipped":
            raise SettingsError(
                "reconstructor.weights: none ship for these parts; give their weights, or "
                "untrained."
            )
        weights = "random" if settings.weights == "untrained" else settings.weights
        parts = {"backbone": backbone, "head": head}
        return build(
            "reconstructor", "noposplat", parts, **{**settings.full, "weights": weights}
        )
    if settings.weights not in (
        "shipped",
        "untrained",
    ):  # the small form loads nothing of the full one
        from edit3r_model.checkpoints import are_of_the_full_network

        if are_of_the_full_network(settings.weights):
            return build(
                "reconstructor",
                "noposplat",
                **{**settings.full, "weights": settings.weights},
            )
    if settings.full:
        raise SettingsError(
            "reconstructor.full: counts with weights of the full network only, such as official."
        )
    return None


def load_parts(weights: str, backbone: Backbone, head: GaussianHead) -> nn.Module:
    """Give the parts the 'shipped' weights or those of a file; 'untrained' ones keep their own,
    which is announced.
    """
    network = nn.ModuleDict({"backbone": backbone, "head": head})
    network.to(memory_format=torch.channels_last)  # a quarter quicker on a CPU
    if weights == "untrained":
        reporting.warn(
            "edit3r: the network is untrained; repairs and fused edits are those of a random start."
        )
        return network.eval()
    path = SHIPPED if weights == "shipped" else Path(weights)
    path = path / WEIGHTS if path.is_dir() else path
    load_weights(network, path)
    card = path.with_suffix(".json")  # data, steps, licence
    licence = (
        json.loads(card.read_text(encoding="utf-8")).get("licence")
        if card.is_file()
        else None
    )
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    reporting.note(
        "weights.edit3r",
        {"file": path.name, "sha256": digest, "licence": licence or "not stated"},
    )
    return network.eval()


def network_grid(
    image_size: tuple[int, int], longest: int, patch_size: int
) -> tuple[int, int]:
    """Return (height, width) near the image's shape with the longer side `longest`, in multiples of
    GRID and patch.
    """
    height, width = image_size
    scale, unit = longest / max(height, width), lcm(GRID, patch_size)
    return tuple(max(2, round(side * scale / unit)) * unit for side in (height, width))


def _in_unit(
    geometry: MatchedGeometry, unit: Float[Tensor, "batch"]
) -> MatchedGeometry:
    """The geometry with `unit` as its unit of length."""
    factor = 1 / unit
    return replace(
        geometry,
        c2w=scale_poses(geometry.c2w, factor[:, None]),
        depths=geometry.depths * factor[:, None, None, None],
    )


def _back_from_unit(
    reconstruction: Reconstruction, unit: Float[Tensor, "batch"]
) -> Reconstruction:
    """The reconstruction in the matcher's own unit of length."""
    gaussians, cameras, factor = (
        reconstruction.gaussians,
        reconstruction.cameras,
        unit[:, None, None],
    )
    moved = replace(
        gaussians, means=gaussians.means * factor, scales=gaussians.scales * factor
    )
    return Reconstruction(
        moved, replace(cameras, c2w=scale_poses(cameras.c2w, unit[:, None]))
    )


def _hide_unplaced(
    reconstruction: Reconstruction, geometry: MatchedGeometry
) -> Reconstruction:
    """Make the Gaussians of views that could not be placed transparent."""
    if bool(geometry.registered.all()):
        return reconstruction
    gaussians = reconstruction.gaussians
    shown = geometry.registered[:, gaussians.view_index].to(gaussians.opacities.dtype)
    return replace(
        reconstruction,
        gaussians=replace(gaussians, opacities=gaussians.opacities * shown),
    )
