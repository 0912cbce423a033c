"""Contract of a rasterizer."""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import Cameras, Gaussians, Rendering
from edit3r.pipeline.config import DEFAULTS
from edit3r.plugins.registry import default_registry
from edit3r_testing.contract import GAUSSIAN_FIELDS, Contract
from edit3r_testing.scenes import cameras_around, gaussian_cloud

REFERENCE = DEFAULTS["reference_rasterizer"]
SCENE_SETTINGS = ("near", "far", "background")
"""Settings that say what is to be seen, which the reference must share with the rasterizer under
test.
"""


def reference_rasterizer(**settings: Any) -> Rasterizer:
    """The plain rasterizer that others are compared with."""
    return default_registry().build("rasterizer", REFERENCE, **settings)


class RasterizerContract(Contract):
    """Agrees with the reference `torch` in images and gradients; empty scenes."""

    kind = "rasterizer"
    subject: Rasterizer
    agreement: float = (
        2e-3  # largest difference of colours and alphas from the reference
    )

    def render(self, gaussians: Gaussians, cameras: Cameras) -> Rendering:
        """One rendering, its shapes checked."""
        what = f"render() of {gaussians.count} Gaussians and {cameras.count} cameras"
        rendering = self.call(
            what,
            self.subject.render,
            gaussians.to(self.device),
            cameras.to(self.device),
        )
        self.require_type("render() returned", rendering, Rendering, "Rendering")
        batch, count = cameras.c2w.shape[:2]
        for name, channels in (("images", 3), ("alphas", 1), ("depths", 1)):
            shape = (batch, count, channels, *cameras.image_size)
            self.require_tensor(
                f"Rendering.{name}",
                getattr(rendering, name),
                shape,
                gaussians.means.dtype,
            )
        return rendering

    def test_rendering_is_in_range(self) -> None:
        rendering = self.render(gaussian_cloud(), cameras_around())
        self.require_range(
            "alphas",
            rendering.alphas.detach(),
            0,
            1 + 1e-5,
            "an alpha is 1 minus the transmittance",
        )
        self.require(
            rendering.images.min() >= -1e-6,
            "a colour is negative; clamp max(0, SH + 0.5) per Gaussian.",
        )
        self.require(
            rendering.depths.min() >= 0,
            "a depth is negative; Gaussians behind the camera must be culled.",
        )

    def test_agrees_with_the_reference(self) -> None:
        for batch, count, degree, size in (
            (1, 2, 0, (24, 32)),
            (2, 1, 1, (33, 31)),
            (1, 1, 3, (16, 40)),
        ):
            cloud, cameras = (
                gaussian_cloud(batch=batch, degree=degree, seed=degree),
                cameras_around(count, size, batch),
            )
            mine, reference = (
                self.render(cloud, cameras),
                self._reference.render(cloud, cameras),
            )
            case = f"{count} cameras of {size[0]}x{size[1]}, degree {degree}"
            self._require_agreement(case, mine, reference)

    def test_gaussians_behind_the_camera_are_not_seen(self) -> None:
        cloud, cameras = gaussian_cloud(), cameras_around()
        behind = replace(cloud, means=cloud.means * torch.tensor([1.0, 1.0, -1.0]))
        seen = self.render(behind, cameras).alphas.abs().max().item()
        self.require(
            seen == 0,
            f"Gaussians behind the camera reach an alpha of {seen:.3g}; cull z <= near.",
        )

    def test_empty_scene_shows_the_background(self) -> None:
        cloud, cameras = gaussian_cloud(), cameras_around()
        empty = cloud.select(torch.zeros(cloud.count, dtype=torch.bool))
        rendering = self.render(empty, cameras)
        nothing = rendering.alphas.abs().max() + rendering.depths.abs().max()
        self.require(
            nothing == 0,
            "a scene of 0 Gaussians has alphas or depths; both must be 0 everywhere.",
        )
        flat = rendering.images.flatten(-2)
        self.require(
            (flat == flat[..., :1]).all(),
            "a scene of 0 Gaussians must show the background colour only.",
        )

    def test_same_input_gives_the_same_image(self) -> None:
        cloud, cameras = gaussian_cloud(), cameras_around()
        first, second = self.render(cloud, cameras), self.render(cloud, cameras)
        fix = "sort ties by index and sum in a fixed order"
        self.require_equal(
            "two renderings of one scene differ",
            first.images,
            second.images,
            fix,
            self.tolerance,
        )

    def test_gradients_agree_with_the_reference(self) -> None:
        scene, cameras = gaussian_cloud(30), cameras_around(1)
        mine, reference = (
            self._gradients(one, scene, cameras)
            for one in (self.subject, self._reference)
        )
        for field, a, b in zip(GAUSSIAN_FIELDS, mine, reference):
            self.require(
                bool(torch.isfinite(a).all()),
                f"the gradient of {field} is not finite; guard divisions by depth.",
            )
            far = (a.cpu() - b).norm() / b.norm().clamp(min=1e-6)
            self.require(
                far < 0.05,
                f"the gradient of {field} is {100 * far:.1f} % off the reference; correct it.",
            )

    @property
    def _reference(self) -> Rasterizer:
        """The plain rasterizer with the settings of the one under test, as far as it has them."""
        registry = default_registry()
        known = registry.settings_class(
            registry.find("rasterizer", REFERENCE)
        ).model_fields
        given = getattr(self.subject, "settings", None)
        same = {
            name: getattr(given, name)
            for name in known
            if hasattr(given, name) and name in SCENE_SETTINGS
        }
        return reference_rasterizer(**same)

    def _require_agreement(
        self, case: str, mine: Rendering, reference: Rendering
    ) -> None:
        for name in ("images", "alphas"):
            a, b = getattr(mine, name).detach().cpu(), getattr(reference, name).detach()
            fix = "compare conventions: pixel centres at +0.5, linear scales, wxyz quaternions, front-to-back blending"
            self.require_equal(
                f"{name} differ from rasterizer 'torch' ({case})",
                a,
                b,
                fix,
                self.agreement,
            )
        a, b, covered = mine.depths.cpu(), reference.depths, reference.alphas > 0.05
        fix = "depth is the expected camera z, sum(w z) / sum(w)"
        self.require_equal(
            f"depths differ from rasterizer 'torch' ({case})",
            a[covered],
            b[covered],
            fix,
            0.02,
        )

    def _loss(
        self, rasterizer: Rasterizer, scene: Gaussians, cameras: Cameras
    ) -> Float[Tensor, ""]:
        """A smooth scalar of everything rendered, summed in float64."""
        rendering = rasterizer.render(scene, cameras)
        generator = torch.Generator().manual_seed(2)
        total = torch.zeros((), dtype=torch.float64, device=rendering.images.device)
        for tensor in (rendering.images, rendering.alphas, 0.1 * rendering.depths):
            weights = torch.rand(
                tensor.shape, generator=generator, dtype=torch.float64
            ).to(tensor.device)
            total = total + (weights * tensor.double()).sum()
        return total

    def _gradients(
        self, rasterizer: Rasterizer, scene: Gaussians, cameras: Cameras
    ) -> list[Tensor]:
        device = self.device if rasterizer is self.subject else torch.device("cpu")
        leaves = [
            getattr(scene, field).to(device).clone().requires_grad_()
            for field in GAUSSIAN_FIELDS
        ]
        moved = replace(scene.to(device), **dict(zip(GAUSSIAN_FIELDS, leaves)))
        loss = self.call("render()", self._loss, rasterizer, moved, cameras.to(device))
        self.require(
            loss.requires_grad,
            "the rendering carries no gradient; it must be differentiable in the Gaussians.",
        )
        gradients = torch.autograd.grad(loss, leaves, allow_unused=True)
        absent = [
            field
            for field, gradient in zip(GAUSSIAN_FIELDS, gradients)
            if gradient is None
        ]
        self.require(
            not absent,
            f"no gradient reaches {', '.join(absent)}; the rendering must depend on every field.",
        )
        return list(gradients)
