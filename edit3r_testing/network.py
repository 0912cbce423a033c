"""Contracts of the two halves of a reconstruction network: backbone and head."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

import edit3r
from edit3r.contract.interfaces import (
    Backbone,
    GaussianHead,
    Geometry,
)
from edit3r.contract.types import PER_GAUSSIAN, Features, Gaussians, Views
from edit3r.kit import asking
from edit3r.kit.checks import require_gaussians
from edit3r_testing.contract import Contract
from edit3r_testing.scenes import true_geometry

PATCHES = (2, 3)


class TinyBackbone(Backbone):
    """The simplest backbone there is, to try heads on: linear maps of each patch's pixels."""

    class Settings(edit3r.Settings):
        """Nothing to set."""

    settings: Settings

    def __init__(
        self, patch_size: int = 16, feature_widths: tuple[int, ...] = (12, 16, 20, 24)
    ) -> None:
        super().__init__()
        self.settings = self.Settings()
        self.patch_size = patch_size
        self.feature_widths = feature_widths
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.map = nn.Conv2d(3, sum(feature_widths), patch_size, patch_size)

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
        geometry: Geometry | None = None,
    ) -> Features:
        features = self.map(images.flatten(0, 1))  # [B * V, C, rows, columns]
        grid = tuple(features.shape[-2:])
        tokens = features.flatten(2).transpose(1, 2).unflatten(0, images.shape[:2])
        return Features(tokens.split(self.feature_widths, -1), grid)


class BackboneContract(Contract):
    """Features of the declared widths for any number of views, with finite gradients."""

    kind = "backbone"
    subject: Backbone
    # rows and columns of patches of the test photos
    patches: tuple[int, int] = PATCHES

    def test_features_have_the_declared_shape(self) -> None:
        for count in (2, 3, 4):
            features = self._features(self._views(count))
            for index, level in enumerate(features.levels):
                name = f"levels[{index}] of {count} views"
                self.require_tensor(name, level, tuple(level.shape))

    def test_batch_items_are_independent(self) -> None:
        views = self._views(2, batch=2)
        together = self._features(views)
        alone = self._features(views.scene(1))
        fix = "keep scenes apart: attention runs over views and tokens, never over the batch"
        what = "scene 1 of a batch differs from it alone"
        for a, b in zip(together.levels, alone.levels):
            self.require_equal(what, a[1:], b, fix, 1e-4)

    def test_gradients_are_finite(self) -> None:
        views = self._views(2)
        images = views.images.clone().requires_grad_()
        rest = (views.intrinsics, _geometry(self.subject, views))
        features = self.ask(asking.features, images, *rest)
        require_gradients(self, features.levels, {"images": images})

    def _features(self, views: Views) -> Features:
        given = (views.images, views.intrinsics, _geometry(self.subject, views))
        with torch.no_grad():
            return self.ask(asking.features, *given)

    def _views(self, count: int, batch: int = 1) -> Views:
        size = tuple(side * self.subject.patch_size for side in self.patches)
        return self.scene(count, batch, size).views


class HeadContract(Contract):
    """Valid Gaussians, `per_pixel` of each, for any number of views, with finite gradients."""

    kind = "head"
    subject: GaussianHead
    # rows and columns of patches of the test photos
    patches: tuple[int, int] = PATCHES

    def make_backbone(self) -> Backbone:
        """The backbone the head is tried on; override for a head that needs a certain one."""
        return TinyBackbone()

    @property
    def backbone(self) -> Backbone:
        cls = type(self)
        if "_backbone" not in cls.__dict__:
            cls._backbone = self.make_backbone().to(self.device)
        return cls._backbone

    def build_with(self, settings: Mapping[str, Any], **parts: Any) -> GaussianHead:
        return super().build_with(settings, backbone=self.backbone, **parts)

    def test_gaussians_are_valid_for_any_number_of_views(self) -> None:
        for count in (2, 3, 4):
            views = self._views(count)
            gaussians = self._gaussians(views)
            self.call(require_gaussians, self.subject, gaussians, 1, views.images.dtype)

    def test_view_index_is_view_major(self) -> None:
        views, each = self._views(3), self.subject.per_pixel
        if each == 0:
            return
        height, width = views.image_size
        count = height * width * each
        expected = torch.arange(3, device=self.device).repeat_interleave(count)
        fix = (
            "set view_index to torch.arange(V).repeat_interleave(H * W * per_pixel) and order "
            "Gaussians view by view, row by row"
        )
        found = self._gaussians(views).view_index
        self.require_equal("view_index is not view-major", found, expected, fix)

    def test_gradients_are_finite(self) -> None:
        views = self._views(2)
        features = self._features(views)
        levels = [level.clone().requires_grad_() for level in features.levels]
        features = replace(features, levels=tuple(levels))
        given = self._given(views)
        gaussians = self.ask(asking.gaussians, features, *given)
        outputs = [getattr(gaussians, name) for name in PER_GAUSSIAN]
        named = {f"levels[{i}]": level for i, level in enumerate(levels)}
        require_gradients(self, outputs, named)

    def _gaussians(self, views: Views) -> Gaussians:
        given = (self._features(views), *self._given(views))
        with torch.no_grad():
            return self.ask(asking.gaussians, *given)

    def _features(self, views: Views) -> Features:
        given = (views.images, views.intrinsics, _geometry(self.backbone, views))
        with torch.no_grad():
            return self.backbone(*given)

    def _given(self, views: Views) -> tuple:
        """What the head gets beside the features."""
        return views.images, views, _geometry(self.subject, views)

    def _views(self, count: int) -> Views:
        size = tuple(side * self.backbone.patch_size for side in self.patches)
        return self.scene(count, size=size).views


def _geometry(part: Backbone | GaussianHead, views: Views) -> Geometry | None:
    """What a part that uses geometry is given: the true one of the test photos."""
    return true_geometry(views) if part.uses_geometry else None


def require_gradients(
    contract: Contract,
    outputs: Iterable[Tensor],
    inputs: Mapping[str, Tensor],
    network: nn.Module | None = None,
) -> None:
    """Gradients of every output's mean square reach `inputs` and the network, and are finite."""
    network = contract.subject if network is None else network
    total = sum(output.float().square().mean() for output in outputs)
    contract.require(
        total.requires_grad,
        "no gradient arrives; do not detach, and do not compute under no_grad.",
    )
    network.zero_grad()
    total.backward()
    moved = False
    for name, tensor in {**inputs, **dict(network.named_parameters())}.items():
        if tensor.grad is not None and tensor.grad.numel():
            finite = torch.isfinite(tensor.grad).all()
            fix = "look for sqrt, norm or division at 0"
            contract.require(finite, f"the gradient of {name} is not finite; {fix}.")
            moved |= bool(tensor.grad.abs().max() > 0)
    contract.require(
        moved, "every gradient is zero; the output does not depend on the input."
    )
