"""Add Gaussians where the scene is not fitted well yet, and remove those that show nothing.

3D Gaussian Splatting, section 5.2: where the loss has a large gradient by a Gaussian's position in the image, a small
one is cloned and a large one is split in two. Transparent ones, and after opacities were reset also huge ones, are
removed.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from edit3r.geometry.cameras import invert_rigid, project
from edit3r.geometry.rotations import quats_to_matrices
from edit3r.types import Cameras
from edit3r_optimisers.settings import FitSettings
from edit3r_optimisers.trainable import Parameters, TrainableGaussians

CHILDREN = 2
SHRINKING = 1.6  # a child's scales are its parent's over this
RESET_OPACITY = 0.01


@dataclass
class DensityStatistics:
    """Statistics of each Gaussian over the steps since the last control."""

    gradient: Float[Tensor, "gaussian"]  # sum of gradients by the position in the image [loss per half image]
    seen: Float[Tensor, "gaussian"]  # steps in which it lay in the image
    size: Float[Tensor, "gaussian"]  # largest standard deviation in an image [image widths]

    @staticmethod
    def of(count: int, like: Tensor) -> "DensityStatistics":
        return DensityStatistics(*(like.new_zeros(count) for _ in range(3)))

    @torch.no_grad()
    def add(self, parameters: Parameters, gradient: Float[Tensor, "gaussian 3"], camera: Cameras) -> None:
        """Count one step that rendered `camera` (one) and found this gradient of the loss by the centres."""
        positions, z = project(parameters.means, camera.intrinsics[0, 0], camera.c2w[0, 0])
        visible = (z > 0) & ((positions >= 0) & (positions <= 1)).all(-1)
        self.gradient += torch.where(visible, gradient_in_image(parameters.means, gradient, camera), 0.0)
        self.seen += visible
        width = parameters.scales.exp().amax(-1) * camera.intrinsics[0, 0, 0, 0] / z
        self.size = torch.where(visible, torch.maximum(self.size, width), self.size)

    @property
    def mean_gradient(self) -> Float[Tensor, "gaussian"]:
        return self.gradient / self.seen.clamp(min=1)


def gradient_in_image(
    means: Float[Tensor, "gaussian 3"], gradient: Float[Tensor, "gaussian 3"], camera: Cameras
) -> Float[Tensor, "gaussian"]:
    """Return the length of the loss's gradient by a Gaussian's position in the image [loss per half image side].

    Moving a centre sideways by dx moves it by 2 f dx / z half images (f in image widths or heights), so the gradient
    by the position (the paper's NDC) is the one by the centre, in the camera's axes, times z / (2 f).
    """
    w2c = invert_rigid(camera.c2w[0, 0])
    z = means @ w2c[2, :3] + w2c[2, 3]
    sideways = gradient @ w2c[:2, :3].T
    focal = camera.intrinsics[0, 0, [0, 1], [0, 1]]
    return (sideways * z[:, None] / (2 * focal)).norm(dim=-1)


def is_due(settings: FitSettings, done: int, steps: int) -> bool:
    """Tell whether Gaussians are added and removed after `done` of `steps` steps."""
    late = done > settings.densify_until * steps
    return done > settings.densify_from and not late and done % settings.densify_every == 0


def needs_statistics(settings: FitSettings, done: int, steps: int) -> bool:
    """Tell whether a control that uses the statistics of step `done` is still to come."""
    last = settings.densify_until * steps
    return done <= last and settings.densify_from < last


def is_reset_due(settings: FitSettings, done: int, steps: int) -> bool:
    """Tell whether opacities are reset after `done` of `steps` steps."""
    every = settings.reset_every
    return every > 0 and done % every == 0 and done <= settings.densify_until * steps


@torch.no_grad()
def control_density(
    scene: TrainableGaussians, statistics: DensityStatistics, settings: FitSettings, extent: float, done: int, seed: int
) -> None:
    """Clone, split and remove Gaussians in place; `statistics` no longer fit the scene afterwards."""
    growing = _to_grow(statistics.mean_gradient, settings.grow_gradient, settings.most - len(scene))
    large = scene.parameters.scales.exp().amax(-1) > settings.split_size * extent
    size = statistics.size
    chosen = growing & ~large
    scene.append(scene.parameters[chosen], scene.view_index[chosen])
    parents = _padded(growing & large, len(scene))
    generator = torch.Generator().manual_seed((seed * 1_000_003 + done) % 2**63)
    scene.append(split(scene.parameters[parents], generator), scene.view_index[parents].repeat(CHILDREN))
    kept = ~_padded(parents, len(scene)) & ~_superfluous(scene, size, settings, extent, done)
    if kept.any():
        scene.keep(kept)


def split(parents: Parameters, generator: torch.Generator) -> Parameters:
    """Draw two children from each parent as a distribution, smaller by 1.6."""
    scales = parents.scales.exp().repeat(CHILDREN, 1)
    offsets = torch.randn(scales.shape, generator=generator, dtype=scales.dtype).to(scales) * scales
    turned = (quats_to_matrices(parents.quats).repeat(CHILDREN, 1, 1) @ offsets[..., None])[..., 0]
    repeated = {n: v.repeat(CHILDREN, *[1] * (v.ndim - 1)) for n, v in vars(parents).items()}
    repeated["means"] = repeated["means"] + turned
    repeated["scales"] = (scales / SHRINKING).log()
    return Parameters(**repeated)


def _to_grow(gradient: Float[Tensor, "gaussian"], threshold: float, room: int) -> Bool[Tensor, "gaussian"]:
    """Choose those at or above the threshold; where they are more than `room`, those of the largest gradients."""
    growing = gradient >= threshold
    if int(growing.sum()) > max(0, room):
        order = torch.where(growing, gradient, -1.0).argsort(descending=True, stable=True)
        growing = torch.zeros_like(growing)
        growing[order[: max(0, room)]] = True
    return growing


def _superfluous(
    scene: TrainableGaussians, size: Float[Tensor, "old"], settings: FitSettings, extent: float, done: int
) -> Bool[Tensor, "gaussian"]:
    """Find transparent Gaussians; once opacities were reset also those too large in the world or in an image."""
    parameters = scene.parameters
    gone = parameters.opacities.sigmoid() < settings.prune_opacity
    if settings.reset_every and done > settings.reset_every:
        gone = gone | (parameters.scales.exp().amax(-1) > settings.prune_world * extent)
        gone = gone | _padded(size > settings.prune_view, len(scene))
    return gone


def _padded(mask: Bool[Tensor, "old"], count: int) -> Bool[Tensor, "count"]:
    """Extend the mask to a scene that has grown since, with False for what was added."""
    return torch.cat((mask, mask.new_zeros(count - len(mask))))
