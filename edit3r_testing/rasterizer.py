"""Contract of a rasterizer."""

from dataclasses import replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.contract.interfaces import Rasterizer
from edit3r.contract.types import (
    PER_GAUSSIAN,
    RENDERED,
    Cameras,
    Gaussians,
    Rendering,
)
from edit3r.kit import asking
from edit3r.loading.registry import default_registry
from edit3r.running.config import DEFAULTS
from edit3r_testing.contract import Contract
from edit3r_testing.scenes import cameras_around, gaussian_cloud

REFERENCE = DEFAULTS["reference_rasterizer"]

SCENE_SETTINGS = ("near_plane", "far_plane", "background")
"""Settings that say what is to be seen, which the reference shares with the one under test."""


def reference_rasterizer(**settings: Any) -> Rasterizer:
    """The plain rasterizer that others are compared with."""
    return default_registry().build("rasterizer", REFERENCE, **settings)


class RasterizerContract(Contract):
    """Agrees with the reference `torch` in what it gives, and in gradients; empty scenes."""

    kind = "rasterizer"
    subject: Rasterizer
    # largest difference of colours and alphas from the reference
    agreement: float = 2e-3

    def render(self, gaussians: Gaussians, cameras: Cameras) -> Rendering:
        """One rendering that keeps what the pipeline checks."""
        subject = self.subject  # skips the claim where the device is missing
        given = (gaussians.to(self.device), cameras.to(self.device))
        return self.ask(asking.render, *given, subject=subject)

    def test_rendering_is_in_range(self) -> None:
        self.require(
            bool(self.subject.gives), "its `gives` is empty; name what it renders."
        )
        given = self.render(gaussian_cloud(), cameras_around()).given
        if "images" in given:
            fix = "clamp max(0, SH + 0.5) per Gaussian"
            self.require_range("images", given["images"], -1e-6, torch.inf, fix)

    def test_agrees_with_the_reference(self) -> None:
        self._compare(batch=1, cameras=2, degree=0, size=(24, 32))
        self._compare(batch=2, cameras=1, degree=1, size=(33, 31))
        self._compare(batch=1, cameras=1, degree=3, size=(16, 40))

    def test_gaussians_behind_the_camera_are_not_seen(self) -> None:
        cloud = gaussian_cloud()
        behind = replace(cloud, means=cloud.means * torch.tensor([1.0, 1.0, -1.0]))
        empty = cloud.select(torch.arange(0))
        found = self.render(behind, cameras_around()).given
        fix = "Gaussians behind the camera are seen: cull z <= near_plane"
        for name, nothing in self.render(empty, cameras_around()).given.items():
            self.require_equal(f"{name} of them", found[name], nothing, fix, 0)

    def test_empty_scene_shows_the_background(self) -> None:
        empty = gaussian_cloud().select(torch.arange(0))
        rendering = self.render(empty, cameras_around())
        for name, tensor in rendering.given.items():
            flat = tensor.flatten(-2)
            self.require(
                name not in ("alphas", "depths") or bool((flat == 0).all()),
                "a scene of 0 Gaussians has alphas or depths; both must be 0 everywhere.",
            )
            self.require(
                bool((flat == flat[..., :1]).all()),
                "a scene of 0 Gaussians must show the background colour only.",
            )

    def test_same_input_gives_the_same_image(self) -> None:
        cloud, cameras = gaussian_cloud(), cameras_around()
        fix = "sort ties by index and sum in a fixed order"

        def drawn() -> Tensor:
            given = self.render(cloud, cameras).given.values()
            return torch.cat([tensor.flatten() for tensor in given])

        self.require_same_twice(drawn, "scene", fix)

    def test_gradients_agree_with_the_reference(self) -> None:
        scene, cameras = gaussian_cloud(30), cameras_around(1)
        mine = self._gradients(self.subject, scene, cameras, self.device)
        reference = self._gradients(
            self._reference, scene, cameras, torch.device("cpu")
        )
        for field, a, b in zip(PER_GAUSSIAN, mine, reference):
            if b is None:  # as of colours by depths
                continue
            self.require(
                a is not None,
                f"no gradient reaches {field}; the rendering must depend on it.",
            )
            self.require(
                torch.isfinite(a).all(),
                f"the gradient of {field} is not finite; guard divisions by depth.",
            )
            far = (a.cpu() - b).norm() / b.norm().clamp(min=1e-6)
            self.require(
                far < 0.05,
                f"the gradient of {field} is {far:.1%} off the reference; correct it.",
            )

    @property
    def _reference(self) -> Rasterizer:
        """The plain rasterizer with the settings of the one under test, as far as it has them."""
        given = getattr(self.subject, "settings", None)
        same = {
            name: getattr(given, name)
            for name in SCENE_SETTINGS
            if hasattr(given, name)
        }
        return reference_rasterizer(**same)

    def _compare(
        self, batch: int, cameras: int, degree: int, size: tuple[int, int]
    ) -> None:
        """Render a cloud by both."""
        cloud = gaussian_cloud(batch=batch, degree=degree, seed=degree)
        around = cameras_around(cameras, size, batch)
        mine = self.render(cloud, around).to("cpu")
        reference = self._reference.render(cloud, around)
        case = (
            f"differ from the reference ({cameras} cameras of {size}, degree {degree})"
        )
        fix = (
            "compare conventions: pixel centres at +0.5, linear scales, wxyz quaternions, "
            "front-to-back blending"
        )
        for name in ("images", "alphas"):
            if name in mine.given:
                a, b = mine.given[name], reference.given[name]
                self.require_equal(f"{name} {case}", a, b, fix, self.agreement)
        if "depths" in mine.given:
            covered = reference.alphas > 0.05
            a, b = mine.depths[covered], reference.depths[covered]
            fix = "depth is the expected camera z, sum(w z) / sum(w)"
            self.require_equal(f"depths {case}", a, b, fix, 0.02)

    def _loss(self, rendering: Rendering) -> Float[Tensor, ""]:
        """A smooth scalar of what the subject gives, summed in float64."""
        given, generator = rendering.given, torch.Generator().manual_seed(2)
        device = next(iter(given.values())).device
        total = torch.zeros((), dtype=torch.float64, device=device)
        for name in RENDERED:
            if name not in self.subject.gives:
                continue
            tensor = given[name] * (0.1 if name == "depths" else 1)
            weights = torch.rand(tensor.shape, generator=generator, dtype=torch.float64)
            total = total + (weights.to(tensor.device) * tensor.double()).sum()
        return total

    def _gradients(
        self,
        rasterizer: Rasterizer,
        scene: Gaussians,
        cameras: Cameras,
        device: torch.device,
    ) -> list[Tensor | None]:
        leaves = {
            name: getattr(scene, name).to(device).clone().requires_grad_()
            for name in PER_GAUSSIAN
        }
        moved = replace(scene.to(device), **leaves)
        given = (moved, cameras.to(device))
        loss = self._loss(self.ask(asking.render, *given, subject=rasterizer))
        return list(torch.autograd.grad(loss, list(leaves.values()), allow_unused=True))
