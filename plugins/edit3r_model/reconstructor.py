"""Reconstructor `noposplat`: photos of any size and number through a pose-free network to Gaussians."""

from typing import Literal

import torch
from pydantic import Field
from torch import nn

from edit3r.config import PartChoice, Settings
from edit3r.errors import MissingDependencyError, RunError
from edit3r.interfaces import Backbone, GaussianHead, Reconstructor
from edit3r.reporting import note
from edit3r.types import Gaussians, Reconstruction, Views
from edit3r_model.check_views import check_views
from edit3r_model.engine import Precision
from edit3r_model.engine.regional import compile_regions
from edit3r_model.fit import fit_views
from edit3r_model.memory import check_fits, estimate_bytes, explaining_exhaustion
from edit3r_model.regrid import finer_grid, regrid
from edit3r_model.weights import load_network

EMPTY = {"seed": None}  # sizes come with the weights; nothing is drawn before


class NoPoSplatReconstructor(Reconstructor):
    """Pose-free reconstruction in one pass: backbone, head, and the way from any photos to them and back.

    It is handed its parts, so any backbone goes with any head; `weights` then decide their sizes. Gaussians come in
    the frame of view 0, one per pixel and view, and no cameras: the caller finds them from the centres
    (`edit3r.geometry.pose`). Runs without gradients; for training take `.network`, built with `engine=eager`.
    """

    class Settings(Settings):
        backbone: PartChoice = Field(
            default_factory=lambda: PartChoice(name="asymmetric-vit", settings=EMPTY), description="views to features"
        )
        head: PartChoice = Field(
            default_factory=lambda: PartChoice(name="dpt-gaussian", settings=EMPTY), description="features to Gaussians"
        )
        weights: str | None = Field(
            None,
            description="NoPoSplat .ckpt, MASt3R .pth (initialisation), .safetensors, our folder, hub id "
            "owner/name@revision, or 'random' for an untrained network (tests and speed only)",
        )
        resolution: int | None = Field(
            None,
            ge=16,
            le=4096,
            description="photos are scaled down to at most this squared [pixels]; default: the weights', or 256",
        )
        fit: Literal["resize", "pad"] = Field(
            "resize", description="how sides become multiples of the patch: stretched to the nearest, or padded"
        )
        grid_resolution: int | None = Field(
            None,
            ge=16,
            le=8192,
            description="one Gaussian per photo pixel up to this squared, with the photo's own detail; default: one "
            "per pixel of the network's grid",
        )
        precision: Precision = Field(
            "float32", description="of the network: float32, bfloat16, float16 (CUDA), int8 (CPU)"
        )
        head_precision: Precision | Literal["auto"] = Field(
            "auto", description="of the head; auto: as the backbone, beside int8 bfloat16 where the CPU has it"
        )
        engine: Literal["packed", "eager", "compile"] = Field(
            "packed",
            description="packed: oneDNN layouts on a CPU, inference only; eager: plain layers, trainable; compile: "
            "torch.compile of each kind of block, slow to start",
        )
        device: str = Field("auto", description="cpu, cuda, cuda:1, ...; auto: cuda where there is one")
        seed: int = Field(0, description="of weights that are drawn rather than loaded")

    def __init__(self, settings: Settings, backbone: Backbone, head: GaussianHead) -> None:
        self.settings = settings
        if settings.weights is None:
            raise MissingDependencyError(
                "reconstructor noposplat ships no weights; give some with --set reconstructor.weights=FILE (a "
                "NoPoSplat .ckpt, or a folder written by edit3r convert), or use the reconstructor edit3r."
            )
        self.loaded, self._network = load_network(settings, backbone, head)
        self.resolution = settings.resolution or (self.loaded.config.resolution if self.loaded else 256)
        if settings.engine == "compile":
            compile_regions(self._network)

    @property
    def network(self) -> nn.Module:
        """Backbone and head as one module, images [0, 1] and intrinsics to Gaussians."""
        return self._network

    @property
    def device(self) -> torch.device:
        """Where the network lives now."""
        tensors = (*self._network.parameters(), *self._network.buffers())
        return tensors[0].device

    @torch.no_grad()
    def __call__(self, views: Views, source: Views | None = None) -> Reconstruction:
        """Reconstruct `views`; `source` is not used. Raises InputError for bad views, RunError when memory ends."""
        check_views(views, self.min_views)
        backbone = self._network.backbone
        fitted = fit_views(views, backbone.patch_size, self.resolution, self.settings.fit)
        size = fitted.views.image_size
        what = f"reconstructing {views.count} views at {size[0]}x{size[1]}"
        check_fits(estimate_bytes(backbone, len(views.images), views.count, size), self.device, what)
        note("reconstructor.network_input_size", list(size))
        with explaining_exhaustion(what):
            inputs = fitted.views.to(self.device, torch.float32)
            gaussians = self._network(inputs.images, inputs.intrinsics).to(views.images.device)
        _require_finite(gaussians)
        gaussians = fitted.drop_padding(gaussians)
        if self.settings.grid_resolution is not None:
            finer = finer_grid(fitted.inner_size, views.image_size, self.settings.grid_resolution)
            gaussians = regrid(gaussians, fitted.inner_size, finer, views.images)
        return Reconstruction(gaussians)


def _require_finite(gaussians: Gaussians) -> None:
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        if not getattr(gaussians, name).isfinite().all():
            raise RunError(
                f"the network's {name} are not finite; in float16 this is an overflow: set reconstructor.precision to "
                f"bfloat16 or float32."
            )


def from_weights(weights: str, **settings) -> NoPoSplatReconstructor:
    """The reconstructor for a checkpoint of the published architecture, without asking the registry for parts."""
    from edit3r_model.backbone import AsymmetricViT
    from edit3r_model.head import DptGaussianHead

    backbone = AsymmetricViT(AsymmetricViT.Settings(**EMPTY))
    head = DptGaussianHead(DptGaussianHead.Settings(**EMPTY), backbone)
    return NoPoSplatReconstructor(NoPoSplatReconstructor.Settings(weights=weights, **settings), backbone, head)


__all__ = ["NoPoSplatReconstructor", "from_weights"]
