"""Contracts of the two halves of a reconstruction network: backbone and head."""

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edit3r.config import Settings
from edit3r.contract.interfaces import (
    Backbone,
    GaussianHead,
    GeometryBackbone,
    GeometryHead,
    MatchedGeometry,
)
from edit3r.contract.types import Features, Views
from edit3r_testing.contract import Contract, require_valid_gaussians
from edit3r_testing.scenes import photograph


class TinyBackbone(Backbone):
    """The simplest backbone there is, to try heads on: each level a linear map of the patch's
    pixels.
    """

    class Settings(Settings):
        """Nothing to set."""

    def __init__(
        self, patch_size: int = 16, feature_widths: tuple[int, ...] = (12, 16, 20, 24)
    ) -> None:
        super().__init__()
        self.settings = self.Settings()
        self.patch_size, self.feature_widths = patch_size, feature_widths
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.levels = nn.ModuleList(
                nn.Conv2d(3, width, patch_size, patch_size) for width in feature_widths
            )

    def forward(
        self,
        images: Float[Tensor, "batch view 3 height width"],
        intrinsics: Float[Tensor, "batch view 3 3"],
    ) -> Features:
        batch, views = images.shape[:2]
        maps = [
            level(images.flatten(0, 1)) for level in self.levels
        ]  # [B * V, C, rows, columns]
        tokens = tuple(
            m.flatten(2).transpose(1, 2).unflatten(0, (batch, views)) for m in maps
        )
        return Features(tokens, tuple(maps[0].shape[-2:]))


class BackboneContract(Contract):
    """Features of the declared widths for any number of views, with finite gradients."""

    kind = "backbone"
    subject: Backbone
    patches: tuple[int, int] = (2, 3)  # rows and columns of patches of the test photos

    def test_features_have_the_declared_shape(self) -> None:
        for count in (2, 3, 4):
            views = self._views(count)
            features = self._features(views)
            self.require(
                tuple(features.grid) == self.patches,
                f"grid is {features.grid} for {self.patches} patches; it is (height, width) // "
                "patch_size.",
            )
            widths = tuple(self.subject.feature_widths)
            found = len(features.levels)
            self.require(
                found == len(widths),
                f"{found} levels came for feature_widths {widths}; return one per width.",
            )
            tokens = self.patches[0] * self.patches[1]
            for level, width in enumerate(widths):
                name = f"levels[{level}] of {count} views"
                self.require_tensor(
                    name, features.levels[level], (1, count, tokens, width)
                )

    def test_batch_items_are_independent(self) -> None:
        views = self._views(2, batch=2)
        together = self._features(views)
        alone = self._features(Views(views.images[1:], views.intrinsics[1:]))
        fix = "keep scenes apart: attention runs over views and tokens, never over the batch"
        for a, b in zip(together.levels, alone.levels):
            self.require_equal(
                "scene 1 of a batch differs from it alone", a[1:], b, fix, 1e-4
            )

    def test_gradients_are_finite(self) -> None:
        views = self._views(2)
        images = views.images.clone().requires_grad_()
        features = self.call(
            "forward()",
            self.subject,
            images,
            views.intrinsics,
            *_geometry(self.subject, views),
        )
        backward(self, features.levels)
        require_finite_gradients(
            self, {"images": images, **dict(self.subject.named_parameters())}
        )
        self.subject.zero_grad()

    def _features(self, views: Views) -> Features:
        with torch.no_grad():
            given = (views.images, views.intrinsics, *_geometry(self.subject, views))
            features = self.call(
                f"forward() of {views.count} views", self.subject, *given
            )
        self.require_type("forward() returned", features, Features, "Features")
        return features

    def _views(self, count: int, batch: int = 1) -> Views:
        size = tuple(side * self.subject.patch_size for side in self.patches)
        return photograph(count, size, batch).views.to(self.device)


class HeadContract(Contract):
    """One valid Gaussian per pixel for any number of views, with finite gradients."""

    kind = "head"
    subject: GaussianHead
    patches: tuple[int, int] = (2, 3)  # rows and columns of patches of the test photos

    def make_backbone(self) -> Backbone:
        """The backbone the head is tried on; override for a head that needs a certain one."""
        return TinyBackbone()

    @property
    def backbone(self) -> Backbone:
        cls = type(self)
        if "_backbone" not in cls.__dict__:
            cls._backbone = self.make_backbone().to(self.device)
        return cls._backbone

    def build(self) -> GaussianHead:
        if self.component:
            self._skip_unless_usable()
            parts = {"backbone": self.backbone, **self.parts}
            return self.registry.build(
                self.kind, self.component, parts, **self.settings
            )
        return super().build()

    def test_gaussians_are_valid_for_any_number_of_views(self) -> None:
        for count in (2, 3, 4):
            views = self._views(count)
            gaussians = self._gaussians(views)
            require_valid_gaussians(self, gaussians, 1, count)
            height, width = views.image_size
            pixels = count * height * width
            self.require(
                gaussians.count == pixels,
                f"{gaussians.count} Gaussians came for {pixels} pixels; return one each.",
            )

    def test_view_index_is_view_major(self) -> None:
        views = self._views(3)
        height, width = views.image_size
        expected = torch.arange(3, device=self.device).repeat_interleave(height * width)
        fix = "set view_index to torch.arange(V).repeat_interleave(H * W) and order Gaussians view by view, row by row"
        self.require_equal(
            "view_index is not view-major",
            self._gaussians(views).view_index,
            expected,
            fix,
        )

    def test_gradients_are_finite(self) -> None:
        views = self._views(2)
        with torch.no_grad():
            features = self._features(views)
        levels = tuple(level.clone().requires_grad_() for level in features.levels)
        gaussians = self.call(
            "forward()",
            self.subject,
            Features(levels, features.grid),
            *self._given(views),
        )
        fields = (
            gaussians.means,
            gaussians.scales,
            gaussians.quats,
            gaussians.opacities,
            gaussians.harmonics,
        )
        backward(self, fields)
        named = {f"levels[{i}]": level for i, level in enumerate(levels)}
        require_finite_gradients(
            self, {**named, **dict(self.subject.named_parameters())}
        )
        self.subject.zero_grad()

    def _gaussians(self, views: Views):
        with torch.no_grad():
            features = self._features(views)
            return self.call(
                f"forward() of {views.count} views",
                self.subject,
                features,
                *self._given(views),
            )

    def _features(self, views: Views) -> Features:
        return self.backbone(
            views.images, views.intrinsics, *_geometry(self.backbone, views)
        )

    def _given(self, views: Views) -> tuple:
        """What the head gets beside the features."""
        prior = _geometry(self.subject, views)
        return (views.images, views, *prior) if prior else (views.images,)

    def _views(self, count: int) -> Views:
        size = tuple(side * self.backbone.patch_size for side in self.patches)
        return photograph(count, size).views.to(self.device)


def _geometry(
    part: Backbone | GaussianHead, views: Views
) -> tuple[MatchedGeometry, ...]:
    """What a part that takes geometry is given: the true one of the test photos."""
    if not isinstance(part, GeometryBackbone | GeometryHead):
        return ()
    (batch, count), device = views.images.shape[:2], views.images.device
    truth = photograph(count, views.image_size, batch)
    depths = truth.depths.to(device)
    seen = torch.ones(batch, count, dtype=torch.bool, device=device)
    return (
        MatchedGeometry(
            truth.cameras.c2w.to(device), depths, torch.ones_like(depths), seen
        ),
    )


def backward(contract: Contract, outputs: Iterable[Tensor]) -> None:
    """Backward pass from the mean square of every output."""
    total = sum(output.float().square().mean() for output in outputs)
    contract.require(
        total.requires_grad,
        "no gradient arrives; do not detach, and do not compute under no_grad.",
    )
    total.backward()


def require_finite_gradients(contract: Contract, tensors: dict[str, Tensor]) -> None:
    """No gradient is NaN or infinite, and at least one is not zero."""
    gradients = {
        name: tensor.grad for name, tensor in tensors.items() if tensor.grad is not None
    }
    broken = [
        name
        for name, gradient in gradients.items()
        if not torch.isfinite(gradient).all()
    ]
    fix = "look for sqrt, norm or division at 0"
    contract.require(
        not broken, f"the gradient of {', '.join(broken[:3])} is not finite; {fix}."
    )
    moved = any(
        gradient.abs().max() > 0 for gradient in gradients.values() if gradient.numel()
    )
    contract.require(
        moved, "every gradient is zero; the output does not depend on the input."
    )
