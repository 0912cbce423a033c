"""Reconstructor `noposplat`: views of any size and number through the published pose-free network
to Gaussians.
"""

from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args

import torch
from pydantic import Field
from torch import nn

from edit3r.config import PartChoice, Settings, make_settings
from edit3r.contract.interfaces import Backbone, GaussianHead, Reconstructor
from edit3r.contract.types import Gaussians, Reconstruction, Views
from edit3r.errors import MissingDependencyError, RunError, SettingsError
from edit3r.io.pretrained import out_of_memory_told, pick_device
from edit3r.reporting import note, progress, warn
from edit3r_model.checkpoints import LoadedWeights, fill, load_weights
from edit3r_model.engine import EnginePlan, Precision, make_plan, prepare_leaf
from edit3r_model.full_network import GaussianNetwork, NetworkConfig, PartConfig
from edit3r_model.memory import (
    ADVICE,
    check_fits,
    draw_leaf,
    estimate_bytes,
    leaf_names,
)
from edit3r_model.view_fitting import check_views, finer_grid, fit_views, regrid

EMPTY = {"seed": None}  # sizes come with the weights; nothing is drawn before
RANDOM = "random"
RESOLUTION = 256
"""Where neither settings nor weights say: side of the square with the area that images are scaled
down to [pixels].
"""


class NoPoSplatReconstructor(Reconstructor):
    """Pose-free reconstruction in one pass: backbone and head, and the way from images of any size
    to them and back.

    It is handed its parts, so any backbone goes with any head; `weights` then decide their sizes.
    Gaussians come in the frame of view 0, one per pixel and view, and no cameras: the caller finds
    them from the centres (`edit3r.geometry.pose`). In int8 it cannot be trained.
    """

    class Settings(Settings):
        backbone: PartChoice = Field(
            default_factory=lambda: PartChoice(name="asymmetric-vit", settings=EMPTY),
            description="views to features",
        )
        head: PartChoice = Field(
            default_factory=lambda: PartChoice(name="dpt-gaussian", settings=EMPTY),
            description="features to Gaussians",
        )
        weights: str | None = Field(
            None,
            description="'official' (the authors' own), NoPoSplat .ckpt, MASt3R .pth "
            "(initialisation), .safetensors, "
            "our folder, hub id owner/name@revision, or 'random' for an untrained network (tests "
            "and speed only)",
        )
        resolution: int | None = Field(
            None,
            ge=16,
            le=4096,
            description="photos are scaled down to at most this squared [pixels]; default: the "
            "weights', or 256",
        )
        fit: Literal["resize", "pad"] = Field(
            "resize",
            description="how sides become multiples of the patch: stretched to the nearest, or "
            "padded",
        )
        grid_resolution: int | None = Field(
            None,
            ge=16,
            le=8192,
            description="one Gaussian per photo pixel up to this squared, with the photo's own "
            "detail; default: one "
            "per pixel of the network's grid",
        )
        precision: Precision | Literal["auto"] = Field(
            "float32",
            description="of the network: float32, bfloat16, float16 (CUDA), int8 (CPU); auto: "
            "bfloat16 where a product "
            "of each kind, timed while it loads, says that it is faster than float32",
        )
        head_precision: Precision | Literal["auto"] = Field(
            "auto",
            description="of the head; auto: as the backbone, beside int8 bfloat16 where that is "
            "timed faster",
        )
        device: str = Field(
            "auto", description="cpu, cuda, cuda:1, ...; auto: cuda where there is one"
        )
        seed: int = Field(0, description="of weights that are drawn rather than loaded")

    def __init__(
        self, settings: Settings, backbone: Backbone, head: GaussianHead
    ) -> None:
        self.settings = settings
        if settings.weights is None:
            raise MissingDependencyError(
                "reconstructor noposplat ships no weights; give some with --set "
                "reconstructor.weights=FILE (a "
                "NoPoSplat .ckpt, or a folder written by edit3r convert), or use the "
                "reconstructor edit3r."
            )
        self._network = load_network(settings, backbone, head)
        self.resolution = settings.resolution or self._network.config.resolution

    @property
    def network(self) -> nn.Module:
        """Backbone and head as one module, images [0, 1] and intrinsics to Gaussians."""
        return self._network

    @property
    def device(self) -> torch.device:
        """Where the network is now."""
        tensors = (*self._network.parameters(), *self._network.buffers())
        return tensors[0].device

    def __call__(
        self,
        views: Views,
        source: Views | None = None,
        grid: tuple[int, int] | None = None,
    ) -> Reconstruction:
        """Reconstruct `views`; `source` and `grid` are not used.

        Differentiable only while the network is in training mode. Raises InputError for views that
        cannot be used, RunError when memory ends.
        """
        differentiable = self._network.training and torch.is_grad_enabled()
        if differentiable and "int8" in (
            self.settings.precision,
            self.settings.head_precision,
        ):
            raise SettingsError(
                "reconstructor.precision: int8 layers cannot be trained; set precision=float32."
            )
        check_views(views, self.min_views)
        backbone = self._network.backbone
        fitted = fit_views(
            views, backbone.patch_size, self.resolution, self.settings.fit
        )
        size = fitted.views.image_size
        what = f"reconstructing {views.count} views at {size[0]}x{size[1]}"
        check_fits(
            estimate_bytes(backbone, len(views.images), views.count, size),
            self.device,
            what,
        )
        note("reconstructor.network_input_size", list(size))
        with out_of_memory_told(what, ADVICE), torch.set_grad_enabled(differentiable):
            inputs = fitted.views.to(self.device, torch.float32)
            gaussians = self._network(inputs.images, inputs.intrinsics).to(
                views.images.device
            )
        _require_finite(gaussians)
        gaussians = fitted.drop_padding(gaussians)
        if self.settings.grid_resolution is not None:
            finer = finer_grid(
                fitted.inner_size, views.image_size, self.settings.grid_resolution
            )
            gaussians = regrid(gaussians, fitted.inner_size, finer, views.images)
        return Reconstruction(gaussians)


def load_network(
    settings: Settings, backbone: Backbone, head: GaussianHead
) -> GaussianNetwork:
    """Give the empty parts weights, in the sizes of those weights and the numeric form that the
    settings ask for.

    The network comes back in evaluation mode on its device.
    """
    best = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    device = pick_device(settings.device, best, "reconstructor.device")
    plan = make_plan(settings.precision, settings.head_precision, device)
    if settings.weights == RANDOM:
        if any(
            value.is_meta for value in backbone.parameters()
        ):  # empty: its own sizes are now those that count
            backbone = _resized(backbone, _config_of(backbone), RANDOM, "backbone")
        network = _network_of(backbone, head, settings.resolution or RESOLUTION)
        warn(
            "the network's weights are random: the result is noise, of use for tests and speed "
            "only."
        )
        note("reconstructor.weights", {"source": RANDOM})
        leaves = _draw(network, settings.seed)
    else:
        loaded = load_weights(settings.weights)
        network = _sized_like(loaded, backbone, head)
        _report(loaded, network)
        leaves = fill(network, loaded, settings.seed)
    _prepare(network, leaves, plan, device)
    return network.eval()


def _network_of(
    backbone: Backbone, head: GaussianHead, resolution: int
) -> GaussianNetwork:
    """The parts as one network that can say how to build it."""
    return GaussianNetwork(
        backbone,
        head,
        NetworkConfig(_config_of(backbone), _config_of(head), resolution),
    )


def _config_of(part: Backbone | GaussianHead) -> PartConfig:
    return PartConfig(
        part.offer.component.name, part.settings.model_dump(exclude={"seed"})
    )


def _sized_like(
    loaded: LoadedWeights, backbone: Backbone, head: GaussianHead
) -> GaussianNetwork:
    """A network of the parts' kinds with the sizes of `loaded`; settings the user gave explicitly
    win.
    """
    body = _resized(backbone, loaded.config.backbone, loaded.source, "backbone")
    return _network_of(
        body,
        _resized(head, loaded.config.head, loaded.source, "head", body),
        loaded.config.resolution,
    )


def _resized(
    part: nn.Module, config: PartConfig, source: str, kind: str, *needs: nn.Module
) -> nn.Module:
    """`part` built again in the size `config` says; without memory for weights, where its seed may
    be none.
    """
    name = part.offer.component.name
    if name != config.name:
        raise SettingsError(
            f"{source} holds a {kind} {config.name!r}, the settings say {name!r}; "
            f"--set reconstructor.{kind}={config.name} takes the right one."
        )
    given: Mapping[str, Any] = {
        key: getattr(part.settings, key) for key in part.settings.model_fields_set
    }
    seed = type(part).Settings.model_fields.get("seed")
    empty = {"seed": None} if seed and type(None) in get_args(seed.annotation) else {}
    settings = make_settings(
        type(part).Settings, {**config.settings, **given, **empty}, kind
    )
    resized = type(part)(settings, *needs)
    resized.settings, resized.offer = settings, part.offer
    return resized


def _draw(network: GaussianNetwork, seed: int) -> Iterator[tuple[str, nn.Module]]:
    """Initial weights, leaf by leaf; leaves that have weights already keep them."""
    for name in leaf_names(network):
        leaf = network.get_submodule(name)
        if next(leaf.parameters(recurse=False)).is_meta:
            draw_leaf(name, leaf, seed)
        yield name, leaf


def _prepare(
    network: GaussianNetwork,
    leaves: Iterator[tuple[str, nn.Module]],
    plan: EnginePlan,
    device: torch.device,
) -> None:
    """Convert every leaf as soon as it has weights, so that the network never exists twice."""
    total = len(leaf_names(network))
    for done, (name, leaf) in enumerate(leaves, start=1):
        prepare_leaf(network, name, leaf, plan, device)
        progress("loading weights", done, total)


def _report(loaded: LoadedWeights, network: GaussianNetwork) -> None:
    """Note facts about the weights for the run's manifest, and warn of parts that are random."""
    facts = loaded.facts()
    note("reconstructor.weights", facts)
    note(
        "weights.reconstructor",
        {
            "file": facts["source"],
            "sha256": facts["sha256"],
            "licence": facts["licence"],
        },
    )
    if loaded.kind == "noposplat":
        heads = network.backbone.heads, network.backbone.decoder_heads
        note(
            "reconstructor.attention_heads",
            f"{heads[0]} and {heads[1]}: settings, else 64 channels each",
        )
    if loaded.drawn:
        warn(
            f"{loaded.source} initialises the network for training; it does not hold "
            f"{', '.join(loaded.drawn)}, which "
            f"are random: the Gaussians' colours and shapes mean nothing yet."
        )


def _require_finite(gaussians: Gaussians) -> None:
    """Raise RunError that names the first tensor with NaN or infinite values."""
    for name in ("means", "scales", "quats", "opacities", "harmonics"):
        if not getattr(gaussians, name).isfinite().all():
            raise RunError(
                f"the network's {name} are not finite; in float16 this is an overflow: set "
                "reconstructor.precision to "
                f"bfloat16 or float32."
            )
