"""Fit Gaussians to pictures from known cameras: the loop of 3D Gaussian Splatting (Kerbl et al. 2023).

One view a step, L1 and D-SSIM, Adam, density control. Same inputs, same result; a stopped fit continues from its
checkpoint with the same bytes, because everything random is drawn from the seed and the step.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from jaxtyping import Float
from torch import Tensor

from edit3r.interfaces import Rasterizer
from edit3r.reporting import progress
from edit3r.types import Cameras, Gaussians
from edit3r_optimisers import density_control
from edit3r_optimisers.checkpoints import Keeper
from edit3r_optimisers.cloud import Cloud, detached
from edit3r_optimisers.density_control import Growth
from edit3r_optimisers.photometric import photometric_loss
from edit3r_optimisers.schedule import active_degree, step_sizes, view_at
from edit3r_optimisers.settings import FitSettings

__all__ = ["FitPlan", "Fitted", "FixedPictures", "Pictures", "fit", "scene_extent"]


class Pictures(Protocol):
    """What is fitted to; it may change while the fit goes on."""

    images: Float[Tensor, "view 3 height width"]

    def before(self, step: int, scene: Callable[[], Gaussians]) -> None:
        """Called before every step with a way to get the Gaussians so far."""

    def state(self) -> dict[str, Any]:
        """What changed since the beginning, for checkpoints."""

    def restore(self, state: dict[str, Any]) -> None: ...


@dataclass
class FixedPictures:
    """Pictures that stay as they are."""

    images: Float[Tensor, "view 3 height width"]

    def before(self, step: int, scene: Callable[[], Gaussians]) -> None:
        pass

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        pass


@dataclass(frozen=True)
class FitPlan:
    """How long, how and under which name."""

    settings: FitSettings
    steps: int
    seed: int
    text: str  # for the progress bar


@dataclass(frozen=True)
class Fitted:
    """A scene, and the loss of each step before it was taken, each of one view."""

    gaussians: Gaussians
    losses: tuple[float, ...]


def fit(
    start: Gaussians,
    cameras: Cameras,
    pictures: Pictures,
    rasterizer: Rasterizer,
    plan: FitPlan,
    keeper: Keeper | None = None,
) -> Fitted:
    """Move, add and remove Gaussians of one scene (batch 1) until they look like `pictures` from `cameras`."""
    run = _Fit(start, cameras, pictures, rasterizer, plan)
    first = run.resume(keeper)
    for step in range(first, plan.steps):
        run.step(step)
        done = step + 1
        progress(plan.text, done, plan.steps)
        if keeper is not None and (done % keeper.every == 0 or done == plan.steps):
            keeper.save(run.state(done))
    return Fitted(detached(run.cloud.gaussians()), tuple(run.losses))


def scene_extent(gaussians: Gaussians, cameras: Cameras) -> float:
    """Median distance from cameras to Gaussians [scene units].

    The paper takes the cameras' distance from their middle, which is the same for cameras around a scene but next to
    nothing for two photos taken a step apart.
    """
    centres = cameras.c2w[0, :, :3, 3]
    return max(float(torch.cdist(centres, gaussians.means[0].detach()).median()), 1e-6)


class _Fit:
    """A fit in progress."""

    def __init__(
        self, start: Gaussians, cameras: Cameras, pictures: Pictures, rasterizer: Rasterizer, plan: FitPlan
    ) -> None:
        self.cameras, self.pictures, self.rasterizer, self.plan = cameras, pictures, rasterizer, plan
        self.extent = scene_extent(start, cameras)
        self.cloud = Cloud(start, plan.settings.degree)
        self.growth = Growth.of(len(self.cloud), start.means)
        self.losses: list[float] = []

    def step(self, step: int) -> None:
        """Look at one view, move a little, and add and remove Gaussians where that is due."""
        settings, steps = self.plan.settings, self.plan.steps
        self.pictures.before(step, lambda: detached(self.cloud.gaussians()))
        view = view_at(step, self.cameras.count, self.plan.seed)
        camera = self.cameras.select([view])
        with torch.enable_grad():
            scene = self.cloud.gaussians(active_degree(settings, step, steps))
            seen = self.rasterizer.render(scene, camera).images[0, 0]
            loss = photometric_loss(seen, self.pictures.images[view], settings.ssim)
            gradients = self.cloud.gradients(loss)
        self.losses.append(float(loss.detach()))
        if density_control.is_watching(settings, step + 1, steps):
            self.growth.add(self.cloud.rows, gradients.means, camera)
        self.cloud.step(gradients, step_sizes(settings, step, steps, self.extent))
        self._control(step + 1)

    def _control(self, done: int) -> None:
        settings, steps = self.plan.settings, self.plan.steps
        if density_control.is_due(settings, done, steps):
            density_control.control(self.cloud, self.growth, settings, self.extent, done, self.plan.seed)
            self.growth = Growth.of(len(self.cloud), self.cloud.rows.means.detach())
        if density_control.must_reset(settings, done, steps):
            self.cloud.cap_opacities(density_control.RESET_OPACITY)

    def state(self, done: int) -> dict[str, Any]:
        growth = {name: value.clone() for name, value in vars(self.growth).items()}
        return {
            "step": done,
            "cloud": self.cloud.state(),
            "growth": growth,
            "losses": self.losses,
            "pictures": self.pictures.state(),
        }

    def resume(self, keeper: Keeper | None) -> int:
        """Take up what the keeper has; the step to go on with."""
        content = keeper.load() if keeper is not None else None
        if content is None:
            return 0
        self.cloud.restore(content["cloud"])
        self.growth = Growth(**content["growth"])
        self.losses = list(content["losses"])
        self.pictures.restore(content["pictures"])
        return content["step"]
